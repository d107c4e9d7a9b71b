"""Pairs of measurement and picture: the PSF of all, and how well it explains each."""

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import torch

from nolens.calibrate.known_scenes import KnownScenes
from nolens.calibrate.psf_from_scenes import SolvedPsf, psf_from_scenes, unexplained
from nolens.camera import Measurement
from nolens.errors import DataError
from nolens.evaluate import affine_fit, psnr, ssim
from nolens.operators import PixelRectangle
from nolens.progress import ProgressCallback, part_of, within
from nolens.solvers import Reconstructor

_LARGEST = 3
_SMALLEST = 16
_BYTES_PER_PIXEL = 150
_ILL_POSED = 3
_UNEXPLAINED = 0.95
_UNLIKE_THE_OTHERS = 1.3
_ITERATIONS, _TAU = 100, 2.8e-4
_PSF_FRACTION = 0.9
"""Of the work on a pair that is left out; the rest is its reconstruction."""
_SSIM_WINDOW = 11


@dataclass(frozen=True)
class PairsPsf:
    """The PSF of all pairs.

    Parameters
    ----------
    psf
        (channels, rows, columns).
    support_fraction
        Fraction of its pixels where it may have light.
    pairs
        What it says of each pair, channel by channel, in values that JSON has.
    leave_one_out
        How well each pair is explained and reconstructed with the PSF of the others.
    """

    psf: torch.Tensor
    support_fraction: float
    pairs: list[dict[str, Any]]
    leave_one_out: list[dict[str, Any]]

    def figures(self) -> dict[str, Any]:
        """Figures in values that JSON has."""
        return {
            "pixels": list(self.psf.shape[-2:]),
            "support_fraction": round(self.support_fraction, 4),
            "pairs": self.pairs,
            "leave_one_out": self.leave_one_out,
        }

    def warnings(self) -> list[str]:
        """Too few pairs, and those that are explained badly."""
        texts = []
        if len(self.pairs) < _ILL_POSED:
            texts.append(
                f"{len(self.pairs)} pair{'' if len(self.pairs) == 1 else 's'} can be explained by "
                "many PSFs: take five or more, of pictures with much detail"
            )
        means = [sum(row["residual"]) / len(row["residual"]) for row in self.pairs]
        middle = sorted(means)[len(means) // 2]
        for row, mean in zip(self.pairs, means, strict=True):
            if mean > _UNEXPLAINED or (len(means) > 2 and mean > _UNLIKE_THE_OTHERS * middle):
                texts.append(
                    f"the pair {row['name']} is explained badly ({100 * mean:.0f} % of its "
                    f"measurement is left, {100 * middle:.0f} % of the others): is that the "
                    "picture that was displayed, in its place and not turned?"
                )
        return texts


class KnownPairs:
    """Measurements and the pictures that they are of, by name.

    Parameters
    ----------
    measured
        All with the same channels.
    pictures
        Radiance, (channels, rows, columns), and what each is called in messages.
    support
        Where the pictures' pixels lie in the sensor's frame; None for its middle.
    each_channel
        Whether each channel has a PSF of its own.

    Raises
    ------
    DataError
        If pairs do not fit together, show nothing, or are too small or too large.
    """

    def __init__(
        self,
        measured: Mapping[str, Measurement],
        pictures: Mapping[str, tuple[torch.Tensor, str]],
        support: PixelRectangle | None,
        *,
        each_channel: bool,
    ) -> None:
        self.names, self._measured = list(measured), measured
        self.channels = next(iter(measured.values())).channels
        self._scenes = KnownScenes.of(
            [pictures[name][0] for name in self.names],
            [measured[name].values for name in self.names],
            [measured[name].valid for name in self.names],
            support,
            [(pictures[name][1], measured[name].source) for name in self.names],
        )
        every = list(range(len(self.channels)))
        self._groups = [[each] for each in every] if each_channel else [every]
        rows, columns = self._scenes.sensor
        where = self._scenes.support
        sizes = (
            f"the pictures have {where.height}×{where.width} pixels, and the sensor "
            f"{rows}×{columns}"
        )
        if where.height > _LARGEST * rows or where.width > _LARGEST * columns:
            raise DataError(
                f"{sizes}: scale the pictures so that a pixel is what one pixel of the sensor "
                "sees, as a reconstruction shows it"
            )
        if min(rows, columns, where.height, where.width) < _SMALLEST:
            raise DataError(f"{sizes}: give at least {_SMALLEST} in each direction")

    @property
    def bytes_needed(self) -> float:
        """Most memory that `solve` holds at once."""
        return math.prod(self._scenes.extent) * len(self._scenes.measured) * _BYTES_PER_PIXEL

    def solve(self, *, check: bool = False, progress: ProgressCallback | None = None) -> PairsPsf:
        """A PSF for each group of channels that has one in common.

        With a check, it is also solved without each pair in turn.

        Raises
        ------
        DataError
            If no PSF explains the measurements.
        """
        checked = self.names if check else []
        solutions = self._solutions(self.names, part_of(progress, 0, 1 + len(checked)))
        checks = [
            self._left_out(name, part_of(progress, number, 1 + len(checked)))
            for number, name in enumerate(checked, start=1)
        ]
        psf = torch.stack([each.psf for each in solutions])
        support = float(solutions[0].support.double().mean())
        return PairsPsf(psf, support, self._figures(solutions), checks)

    def _solutions(self, names: list[str], progress: ProgressCallback) -> list[SolvedPsf]:
        """The PSF of some pairs, for each group."""
        return [
            psf_from_scenes(
                self._known(names, group), progress=part_of(progress, number, len(self._groups))
            )
            for number, group in enumerate(self._groups)
        ]

    def _figures(self, solutions: list[SolvedPsf]) -> list[dict[str, Any]]:
        """What the solution says of each pair."""
        many = len(self.channels) // len(solutions)

        def of_pair(number: int, values: Callable[[SolvedPsf], torch.Tensor]) -> list[float]:
            part = slice(number * many, (number + 1) * many)
            return [round(each, 4) for psf in solutions for each in values(psf)[part].tolist()]

        return [
            {
                "name": name,
                "gain": of_pair(number, lambda psf: psf.gains),
                "residual": of_pair(number, lambda psf: psf.residual),
                "residual_varying": of_pair(number, lambda psf: psf.residual_varying),
            }
            for number, name in enumerate(self.names)
        ]

    def _left_out(self, name: str, progress: ProgressCallback) -> dict[str, Any]:
        """How well a pair is explained and reconstructed with the PSF of the others.

        The reconstruction is fitted to the picture; pictures below 11 pixels have no SSIM.
        """
        others = [each for each in self.names if each != name]
        solutions = self._solutions(others, within(progress, 0.0, _PSF_FRACTION))
        psf = torch.stack([each.psf for each in solutions])
        residual = torch.cat(
            [
                unexplained(self._known([name], group), plane)
                for group, plane in zip(self._groups, psf, strict=True)
            ]
        )
        advance = within(progress, _PSF_FRACTION, 1 - _PSF_FRACTION)
        reconstructor = Reconstructor(psf, self._scenes.support, _TAU).for_iterations(_ITERATIONS)
        scene = reconstructor.solve(
            self._measured[name], callback=lambda step: advance(step.iteration / _ITERATIONS)
        ).scene
        truth = self._known([name], list(range(len(self.channels)))).scenes
        peak = float(truth.max())
        fitted = affine_fit(scene, truth).clamp(0, peak)
        large = min(truth.shape[-2:]) >= _SSIM_WINDOW
        return {
            "name": name,
            "residual": [round(each, 4) for each in residual.tolist()],
            "psnr_db": round(psnr(fitted, truth, peak), 3),
            "ssim": round(ssim(fitted, truth, peak), 4) if large else None,
        }

    def _known(self, names: list[str], channels: list[int]) -> KnownScenes:
        """Some of the pairs, in some of the channels."""
        starts = [self.names.index(name) * len(self.channels) for name in names]
        return self._scenes.only([start + channel for start in starts for channel in channels])
