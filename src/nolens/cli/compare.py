"""`nolens compare`."""

from typing import Any

from nolens.cli.command import command
from nolens.jobs import compare as compare_job

_COLUMNS = {
    "psnr_db": ("PSNR", ".2f"),
    "ssim": ("SSIM", ".3f"),
    "ms_ssim": ("MS-SSIM", ".3f"),
    "shown_psnr_db": ("PSNR", ".2f"),
    "shown_ssim": ("SSIM", ".3f"),
    "shown_ms_ssim": ("MS-SSIM", ".3f"),
    "lpips": ("LPIPS", ".3f"),
}
_UNITS = {"psnr_db": "PSNR, dB", "ssim": "SSIM", "lpips": "LPIPS"}


def _lines(summary: dict[str, Any]) -> list[str]:
    methods = summary["methods"]
    width = max(len("method"), *map(len, methods))
    shown = [name for name in _COLUMNS if name in next(iter(methods.values()))]
    count = summary["pictures"]
    pictures = f"{count} picture{'s' if count > 1 else ''}"
    lines = [
        f"{pictures}; brightness fitted: {summary['fit']}; PSNR in dB",
        f"{'':{width}}  {'in linear light':<24}  as a screen shows it",
        f"{'method':{width}}  " + "  ".join(f"{_COLUMNS[name][0]:>7}" for name in shown),
    ]
    for method, figures in methods.items():
        texts = (_text(figures[name]["mean"], _COLUMNS[name][1]) for name in shown)
        lines.append(f"{method:{width}}  " + "  ".join(f"{each:>7}" for each in texts))
    for method, figures in methods.items():
        if figures["register"] != "none":
            error = figures["error_px"]
            sure = "unknown" if error is None else f"{error:.2f} pixels"
            lines.append(f"{method} laid on the truth by {figures['register']}, error {sure}")
    for each in summary["differences"]:
        name = each["figure"]
        label = _UNITS[name.removeprefix("shown_")] + (" as shown" if "shown" in name else "")
        form = "+" + _COLUMNS[name][1]
        line = f"{each['method']} − {each['minus']}: {label} {_text(each['mean'], form)}"
        if each["low"] is not None:
            line += f" (95 %: {each['low']:{form}} to {each['high']:{form}})"
        lines.append(line)
    return lines


def _text(value: float | str | None, form: str) -> str:
    return "-" if value is None else "∞" if isinstance(value, str) else f"{value:{form}}"


compare = command(compare_job, _lines, name="compare")
