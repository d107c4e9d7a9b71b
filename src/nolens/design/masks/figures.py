"""What a mask's PSF is like, measured in the twin, and that of the paper's diffuser."""

import math
from dataclasses import dataclass, replace
from typing import Any

from torch import Tensor

from nolens.amounts import finite_or_none
from nolens.camera import LoadedCamera, RandomLenslets
from nolens.design.masks.blank import Blank, MadeMask
from nolens.design.masks.contour import correlation
from nolens.design.masks.tile import spread_over
from nolens.errors import DataError
from nolens.evaluate import pattern_figures, sparsity, spectral_magnitude
from nolens.machine import BYTES_OF_PROGRAM, check_memory
from nolens.optics import PointSource, surface_bytes
from nolens.progress import ProgressCallback
from nolens.quantities import Length
from nolens.twin import Light, Twin, point_spread, relief_points

_FREQUENCIES_PER_MM = (20.0, 40.0, 80.0)
"""Spatial frequencies on the sensor at which the spectral magnitude is given."""
_PAPERS_DIFFUSER = RandomLenslets(
    kind="random-lenslets",
    radius=Length("0.67", "mm"),
    pitch=Length("70", "um"),
    smoothing=Length("11", "um"),
    seed=0,
    grid=Length("1.55", "um"),
    overhang=Length("0.5", "mm"),
)
"""The paper's diffuser, as the preset describes it, around a small part of the sensor."""
_MOST_PIXELS = 576
_MIDDLE_PIXELS = 1152


@dataclass(frozen=True)
class MeasuredMask:
    """A mask around the middle of the sensor, and its PSF there.

    Parameters
    ----------
    twin
        The middle of the camera, with no opening.
    psf
        Of a far point straight ahead, (channels, rows, columns), on at most 576 × 576 pixels;
        every channel is 1 on average.
    """

    twin: Twin
    psf: Tensor

    @classmethod
    def of(cls, twin: Twin, light: Light) -> "MeasuredMask":
        """Compute the PSF."""
        rows, columns = (min(_MOST_PIXELS, count) for count in twin.shape)
        psf = point_spread(
            twin, PointSource(), (rows, columns), superpixel=twin.superpixel, light=light
        )
        return cls(twin, psf.cpu())

    @property
    def plane(self) -> Tensor:
        """The channel that is brightest on the sensor: green, or grey."""
        return self.psf[min(1, len(self.psf) - 1)]

    def summary(self) -> dict[str, Any]:
        """Figures of the mask and of its PSF, in values that JSON has.

        ``width_um`` is the full width at half maximum of the PSF's autocorrelation, ``line_um``
        that of a line with a Gaussian profile, ``width_um`` over √2, and ``pitch_um`` leads from
        the autocorrelation's first peak to its second; ``sparsity`` is the fraction of the sensor
        without light, and ``magnitude`` the spectral magnitude of one mm² of the PSF at each of
        `_FREQUENCIES_PER_MM`. What cannot be measured is None: widths without lines, magnitudes
        where the pixels are too coarse.
        """
        width_um: float | None
        try:
            lines = pattern_figures(self.plane, self.twin.pixel_um)
            width_um, pitch_um = lines.width_um, finite_or_none(lines.pitch_um)
        except DataError:
            width_um = pitch_um = None
        relief = self.twin.mask.relief
        return {
            "width_um": width_um,
            "pitch_um": pitch_um,
            "sparsity": sparsity(self.plane),
            "magnitude": [self._magnitude(each) for each in _FREQUENCIES_PER_MM],
            "height_um": float(relief.height_um.max() - relief.height_um.min()),
            "slope": relief.steepest,
            "line_um": None if width_um is None else width_um / math.sqrt(2),
        }

    def _magnitude(self, per_mm: float) -> float | None:
        try:
            return spectral_magnitude(self.plane, self.twin.pixel_um, per_mm)
        except DataError:
            return None


@dataclass(frozen=True)
class MaskComparison:
    """A new mask and the paper's diffuser in the same camera.

    Parameters
    ----------
    made
        The camera with the new mask.
    own, paper
        Both masks, measured.
    """

    made: MadeMask
    own: MeasuredMask
    paper: MeasuredMask

    @classmethod
    def of(cls, blank: Blank, made: MadeMask, progress: ProgressCallback) -> "MaskComparison":
        """Compute both PSFs.

        Raises
        ------
        OptionError
            If the device has too little memory.
        """
        progress(0.0)
        own, paper = (
            _middle(each, blank)
            for each in (made.loaded, blank.loaded.with_relief(_PAPERS_DIFFUSER))
        )
        measured = MeasuredMask.of(own, blank.light)
        progress(0.6)
        return cls(made, measured, MeasuredMask.of(paper, blank.light))

    def summary(self) -> dict[str, Any]:
        """Figures of both masks, and how a designed one came out, in values that JSON has."""
        summary: dict[str, Any] = {
            "figures": self.own.summary(),
            "paper_diffuser": self.paper.summary(),
            "magnitude_per_mm": list(_FREQUENCIES_PER_MM),
            "stop_reason": "interrupted" if self.made.stopped else "finished",
        }
        if self.made.layout is not None:
            summary["period_um"] = self.made.layout.side * self.made.layout.grid_um
        if self.made.target is not None:
            psf = self.own.psf
            target = spread_over(self.made.target, (psf.shape[1], psf.shape[2]))
            summary["target_correlation"] = [float(correlation(each, target)) for each in psf]
        return summary


def _middle(loaded: LoadedCamera, blank: Blank) -> Twin:
    """The middle of a camera's sensor without an opening, ready to be simulated."""
    sensor = loaded.camera.sensor
    rows, columns = (min(_MIDDLE_PIXELS, count) for count in (sensor.rows, sensor.columns))
    small = sensor.model_copy(update={"rows": rows, "columns": columns})
    mask = loaded.camera.mask.model_copy(update={"aperture": None})
    camera = loaded.camera.model_copy(update={"sensor": small, "mask": mask})
    middle = replace(loaded, camera=camera)
    check_memory(
        BYTES_OF_PROGRAM + surface_bytes(relief_points(middle)),
        blank.device,
        "a smaller --overhang or a larger --pitch needs less",
    )
    return Twin.of(middle, device=blank.device)
