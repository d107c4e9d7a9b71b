"""`nolens demo`."""

import shlex
from typing import Any

from nolens.cli.command import command
from nolens.jobs import run_demo


def _lines(summary: dict[str, Any]) -> list[str]:
    return [
        f"PSNR {summary['psnr_db']:.1f} dB after {summary['iterations']} iterations "
        f"({summary['seconds']:.1f} s on {summary['device']})",
        f"again: {shlex.join(summary['command'])}",
        f"measurement | reconstruction | truth: {summary['picture']}",
    ]


demo = command(run_demo, _lines, name="demo")
