"""Pages of which scripts write parts, between marks, and people the rest. Standard library only."""

from __future__ import annotations

from pathlib import Path


def write_part(path: Path, writer: str, text: str) -> None:
    """Put the text of a script in place of its last; at the page's end where it had none.

    Parameters
    ----------
    path
        Of the page, which need not exist.
    writer
        Name in the marks, such as ``"bench/model.py"``.
    text
        Markdown.
    """
    begin, end = f"<!-- {writer}: begin -->", f"<!-- {writer}: end -->"
    page = path.read_text(encoding="utf-8") if path.exists() else ""
    if [page.count(mark) for mark in (begin, end)] not in ([0, 0], [1, 1]):
        raise SystemExit(f"{path} needs {begin} once, and {end} once after it, or neither")
    if page and begin not in page:
        page += "\n"
    before, _, rest = page.partition(begin)
    after = rest.partition(end)[2] or "\n"
    written = path.with_name(f".{path.name}.part")
    written.write_text(f"{before}{begin}\n\n{text.strip()}\n\n{end}{after}", encoding="utf-8")
    written.replace(path)
