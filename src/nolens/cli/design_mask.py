"""`nolens design mask`."""

from typing import Any

from nolens.cli.command import command
from nolens.jobs import MaskOptions, design_mask


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


mask = command(MaskOptions, design_mask, _lines, name="mask")
