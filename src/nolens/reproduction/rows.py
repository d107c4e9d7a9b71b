"""Rows of the report: what came out here, to stand beside what the paper says."""

from dataclasses import dataclass
from typing import Any

from nolens.files.reports import ReportRow
from nolens.reproduction.paper import PAPER


@dataclass(frozen=True)
class Row:
    """A value that came out here.

    Parameters
    ----------
    key
        Of the paper's value, in `PAPER`.
    value
        The number in the paper's unit; None where there is none.
    text
        The value as it is told.
    why
        How it was found, and why it differs from the paper's.
    sized
        Whether it depends on how much of the sensor is read.
    """

    key: str
    value: float | None
    text: str
    why: str
    sized: bool = False

    @property
    def ratio(self) -> float | None:
        """Value over the paper's."""
        printed = PAPER[self.key].value
        return None if self.value is None or printed is None else self.value / printed

    def told(self, *, reduced: bool) -> ReportRow:
        """The row in words.

        Parameters
        ----------
        reduced
            Whether less than the whole sensor was read.
        """
        printed, ratio = PAPER[self.key], self.ratio
        return ReportRow(
            printed.what,
            printed.where,
            printed.text,
            f"{self.text} (reduced size)" if reduced and self.sized else self.text,
            "" if ratio is None else f"{ratio:.2f}",
            self.why,
        )

    def stored(self, *, reduced: bool) -> dict[str, Any]:
        """The row in values that JSON has."""
        printed = PAPER[self.key]
        return {
            "key": self.key,
            "what": printed.what,
            "where": printed.where,
            "paper": printed.text,
            "paper_value": printed.value,
            "value": self.value,
            "text": self.text,
            "ratio": self.ratio,
            "why": self.why,
            "reduced": reduced and self.sized,
        }


def not_made(keys: tuple[str, ...], reason: str) -> tuple[Row, ...]:
    """Rows of a figure that this camera cannot give."""
    return tuple(Row(key, None, "–", f"Not made with this camera: {reason}") for key in keys)
