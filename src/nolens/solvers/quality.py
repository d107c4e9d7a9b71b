"""How much work goes into a picture: presets of when to stop."""

from dataclasses import dataclass
from enum import StrEnum


class Quality(StrEnum):
    """What a picture is for.

    `DRAFT` is one pass of the Wiener filter; for the others ADMM goes on until a `Stop`.
    """

    DRAFT = "draft"
    PHOTO = "photo"
    EXACT = "exact"


@dataclass(frozen=True)
class Stop:
    """When ADMM stops; the parameters are `admm`'s of these names."""

    iterations: int
    tolerance: float
    scene_tolerance: float
    smooth_part: bool


STOPS = {
    Quality.PHOTO: Stop(200, tolerance=0.0, scene_tolerance=1e-2, smooth_part=False),
    Quality.EXACT: Stop(5000, tolerance=1e-4, scene_tolerance=0.0, smooth_part=True),
}
"""A photo is done when it will no longer change visibly: by 1 % of its norm, as its last steps
predict. Exact means that all relative residuals are at most 1e-4; the low-frequency part of a scene
that fills the view is then solved for directly. A photo leaves that out: it is where a PSF that is
not quite the camera's leads furthest astray (decision 7)."""
