"""`nolens design mask`: a command for every kind of mask."""

from typing import Annotated, Any

from cyclopts import App, Parameter

from nolens.cli.command import command
from nolens.errors import OptionError
from nolens.jobs import MaskOptions, design_mask, mask_kind, mask_kinds


def _lines(summary: dict[str, Any]) -> list[str]:
    lines = _table(summary)
    if "target_correlation" in summary:
        values = ", ".join(f"{each:.3f}" for each in summary["target_correlation"])
        lines.append(f"correlation of the PSF with its target, channel by channel: {values}")
    return [*lines, f"{summary['seconds']:.1f} s on {summary['device']}"]


def _table(summary: dict[str, Any]) -> list[str]:
    """Figures of the mask beside the paper's diffuser in the same camera."""
    own, papers = summary["figures"], summary["paper_diffuser"]
    rows = [
        ("width of the PSF's autocorrelation, µm", "width_um", 1, ".1f"),
        ("line width, µm", "line_um", 1, ".1f"),
        ("pitch of the PSF, µm", "pitch_um", 1, ".1f"),
        ("sparsity, %", "sparsity", 100, ".1f"),
        ("height of the relief, µm", "height_um", 1, ".2f"),
        ("steepest slope", "slope", 1, ".3f"),
    ]
    papers_name = "the paper's"
    lines = [f"{'':42}{'this mask':>12}{papers_name:>12}"]
    for name, key, factor, form in rows:
        cells = (_text(side[key], factor, form) for side in (own, papers))
        lines.append(f"{name:42}" + "".join(f"{cell:>12}" for cell in cells))
    for number, per_mm in enumerate(summary["magnitude_per_mm"]):
        cells = (_text(side["magnitude"][number], 100, ".2f") for side in (own, papers))
        name = f"spectral magnitude of 1 mm² at {per_mm:g}/mm, %"
        lines.append(f"{name:42}" + "".join(f"{cell:>12}" for cell in cells))
    return lines


def _text(value: float | None, factor: float, form: str) -> str:
    return "-" if value is None else format(factor * value, form)


mask = App(name="mask", help="Design a mask for a camera, and write the camera that has it.")
_Words = Annotated[str, Parameter(show=False, allow_leading_hyphen=True)]


@mask.default
def _no_kind(*words: _Words) -> None:
    """Say which kinds there are where the first word is none."""
    if words and not words[0].startswith("-"):
        mask_kind(words[0])
    kinds = ", ".join(mask_kinds())
    raise OptionError(f"no kind is given; name one of {kinds}: nolens {MaskOptions.usage}")


def _add(name: str) -> None:
    """Add the command of a kind."""
    try:
        kind = mask_kind(name)
    except OptionError as error:
        # A package that cannot be loaded must not take the other kinds with it.
        reason = str(error)

        def refuse(*words: _Words) -> None:
            raise OptionError(reason)

        mask.command(refuse, name=name, help=f"{reason}.", help_flags=())
    else:
        mask.command(command(kind, design_mask, _lines, name=name), name=name)


for _kind in mask_kinds():
    _add(_kind)
