"""What is said of a file that a format library fails on."""

from pathlib import Path

from nolens.errors import FileError

_LONGEST = 160


def damage(path: Path, kind: str, error: Exception, advice: str = "") -> FileError:
    """What to raise for a damaged file, with the start of what the library says.

    Parameters
    ----------
    path
        The file.
    kind
        What it was to be, with its article.
    error
        Of the library.
    advice
        What to do, as a sentence without its full stop; to copy it again where it is left out.
    """
    said = " ".join(str(error).split())
    # Objects show themselves as <... at 0x7f...>, which says nothing to a person.
    why = f" ({said[:_LONGEST]})" if said.isprintable() and "<" not in said and said else ""
    return FileError(
        f"{path} cannot be read as {kind}: it is damaged or incomplete{why}. "
        + (advice or "Copy it again from where it was made")
    )
