"""`nolens collect`."""

import webbrowser
from typing import Any

from nolens.capture.screen import Screen
from nolens.cli.command import command
from nolens.cli.messages import say
from nolens.cli.terminal import TerminalReporter
from nolens.jobs import CollectReporter
from nolens.jobs import collect as collect_job


class CollectTerminal(TerminalReporter, CollectReporter):
    """Opens the page of the screen in the browser."""

    def screen(self) -> Screen:
        """The page, which says where it is."""
        from nolens.studio.screen import ScreenPage

        def opened(address: str) -> None:
            say(f"open {address} on the screen before the camera, and press its button")
            webbrowser.open(address)

        return ScreenPage(say, opened)


def _lines(summary: dict[str, Any]) -> list[str]:
    screen = summary["screen"]
    taken, left = summary["pictures"], summary["left"]
    lines = [
        f"{taken} pairs by {summary['source']}"
        + (f", {summary['failed']} failed" if summary["failed"] else "")
        + (f", {left} left: the same command goes on" if left else ""),
        f"screen found to {screen['error_px']:.2f} pixels; it lies in {screen['support']}",
    ]
    folder, dark = summary["outputs"][0], summary["dark"]
    lines.append(
        f"then: nolens calibrate pairs {folder}/measured {folder}/pictures "
        + (f"--dark {folder}/{dark} " if dark else "")
        + f"--distance {summary['distance']} --pixel PITCH -o mycamera (PITCH: of the sensor's "
        "pixels, such as 1.55um)"
    )
    return lines


collect = command(collect_job, _lines, name="collect", reporter=CollectTerminal)
