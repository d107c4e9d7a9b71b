"""At which angles PSFs are to be captured for a scene."""

import math
from dataclasses import dataclass
from itertools import product
from typing import Any

from nolens.calibrate.distances import Layers
from nolens.camera import Camera
from nolens.errors import OptionError
from nolens.quantities import Angle
from nolens.twin import LARGEST_ANGLE_DEG

_MORE_DEG = 1.0
"""Beyond the scene's edge, as the angles will not be met exactly."""
_NARROW_DEG = 20.0
"""Half a scene's width to which the corners and the middle are as good as all nine."""
PLANS = (5, 9, 25, 49)
"""Numbers of angles: corners and middle, or grids with as many along each side."""


@dataclass(frozen=True)
class CapturePlan:
    """At which angles PSFs are to be captured for a scene.

    Parameters
    ----------
    angles_deg
        To the right and up, row by row from the upper left.
    edges_deg
        Of the outermost, to the right and up.
    sensor
        (rows, columns) of the PSFs' pixels on the sensor.
    support
        (height, width) of the scene in pixels.
    """

    angles_deg: list[tuple[float, float]]
    edges_deg: tuple[float, float]
    sensor: tuple[int, int]
    support: tuple[int, int]

    def figures(self) -> dict[str, Any]:
        """Figures in values that JSON has."""
        return {
            "angles_deg": [[right, up] for right, up in self.angles_deg],
            "corner_deg": round(_corner_deg(self.edges_deg), 2),
            "sensor_pixels": list(self.sensor),
            "support": list(self.support),
            "pixels": [self.sensor[0] + self.support[0], self.sensor[1] + self.support[1]],
        }

    @property
    def between_deg(self) -> list[tuple[float, float]]:
        """Angles in the middle between neighbours: at the upper right corner, and at the axis."""
        if len(self.angles_deg) == PLANS[0]:
            between = {(1.0, 0.0), (0.0, 1.0), (0.5, 0.5)}
        else:
            half = 1 / (math.isqrt(len(self.angles_deg)) - 1)
            between = {(1.0, 1 - half), (1 - half, 1.0), (1 - half, 1 - half), (half, half)}
        return sorted((right * self.edges_deg[0], up * self.edges_deg[1]) for right, up in between)

    @classmethod
    def of_scene(
        cls, camera: Camera, angle: tuple[Angle, Angle], count: int | None = None
    ) -> "CapturePlan":
        """Plan the captures for a scene of a full angle across and down.

        Parameters
        ----------
        camera
            With its layers.
        angle
            Of the scene, across and down.
        count
            One of `PLANS`; None takes nine angles, or five for a narrow scene.

        Raises
        ------
        OptionError
            If its corners are farther off the axis than cameras see.
        """
        layers, sensor = Layers.of_camera(camera), camera.sensor
        bin_by = sensor.superpixel
        half = [each.deg / 2 for each in angle]
        across, down = (math.ceil(2 * (each + _MORE_DEG)) / 2 for each in half)
        corner = _corner_deg((across, down))
        if corner > LARGEST_ANGLE_DEG:
            raise OptionError(
                f"a scene of {angle[0]} by {angle[1]} has its corners {corner:.0f} deg "
                f"off the axis, and cameras see to {LARGEST_ANGLE_DEG:g} deg: choose a smaller "
                "angle, or give the height too (--angle 80deg,45deg)"
            )
        height, width = (
            2 * math.ceil(layers.along_um(each) / (sensor.pitch.um * bin_by)) for each in half[::-1]
        )
        if count is None:
            count = 9 if max(half) > _NARROW_DEG else PLANS[0]
        most = math.isqrt(max(count, 9)) // 2
        grid = [
            (right * across / most + 0.0, -down_by * down / most + 0.0)
            for down_by, right in product(range(-most, most + 1), repeat=2)
            if count != PLANS[0] or abs(right) == abs(down_by)
        ]
        return cls(
            grid,
            (across, down),
            (sensor.rows // bin_by, sensor.columns // bin_by),
            (height, width),
        )


def _corner_deg(edges_deg: tuple[float, float]) -> float:
    tangents = [math.tan(math.radians(each)) for each in edges_deg]
    return math.degrees(math.atan(math.hypot(*tangents)))
