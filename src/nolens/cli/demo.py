"""`nolens demo`."""

import json
import shlex
from pathlib import Path
from typing import Annotated

from nolens.cli.app import Json, Output
from nolens.cli.messages import show
from nolens.cli.terminal import TerminalReporter
from nolens.files import readable
from nolens.jobs import expand_home, run_demo


def demo(
    *,
    output: Annotated[Path, Output] = Path("demo"),
    json_: Annotated[bool, Json] = False,
) -> int:
    """Simulate a small lensless camera, and reconstruct a photograph from its files.

    Parameters
    ----------
    output
        Folder for the files of the camera and the pictures.
    json_
        Print one JSON object on standard output.
    """
    reporter = TerminalReporter()
    with reporter:
        result = run_demo(expand_home(output), reporter)
    if json_:
        show(
            json.dumps(
                {
                    **result.outcome.summary,
                    "psnr_db": result.psnr_db,
                    "picture": readable(result.picture),
                    "command": ["nolens", *result.command],
                }
            )
        )
    else:
        summary = result.outcome.summary
        show(
            f"PSNR {result.psnr_db:.1f} dB after {summary['iterations']} iterations "
            f"({summary['seconds']:.1f} s on {summary['device']})"
        )
        show(f"again: {shlex.join(('nolens', *result.command))}")
        show(f"measurement | reconstruction | truth: {readable(result.picture)}")
    return 130 if reporter.interrupted else 0
