"""PSFs that were measured elsewhere: on a sensor's pixels, without black level, not clipped."""

from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
import torch
import torch.nn.functional as nnf
from numpy.typing import NDArray
from scipy import ndimage, sparse
from scipy.sparse.linalg import lsmr
from torch import Tensor

from nolens.calibrate.point_psf import dark_area, no_point_source, stray_light
from nolens.camera import BlackLevel, Frame, Measurement, black_level, check_psf, develop
from nolens.camera.measurement import darkest_corner, saturation_count
from nolens.camera.psf import black_is_known
from nolens.errors import DataError

_UNRELIABLE = 0.05
"""Fraction of saturated pixels beyond which what is put in their place no longer helps much."""
_OFFSET = 1e-2
"""Added before the logarithm, as a fraction of the peak: noise around zero has none."""
_MOST_ABOVE = 4.0
"""How many times the count that clips a clipped peak is taken to have at most."""
_MOST_STEPS, _TOLERANCE = 200, 1e-5
_NO_BACKGROUND = 1e-2
"""Of the mean: less than that in the dark area is light of the PSF, not a black level."""


@dataclass(frozen=True)
class PsfImport:
    """A PSF that was measured elsewhere.

    Parameters
    ----------
    psf
        (channels, rows, columns).
    channels
        Name of each.
    merged
        Pixels of the file along one of the PSF's.
    background
        Black level of each channel in counts, read off the area that an aperture keeps dark
        where nobody states it; zero if nothing was subtracted for it.
    black_stated
        Whether the file, a dark frame or a person states the black level.
    saturated_fraction
        Of the pixels, in the channel that has most.
    raised
        Highest value that a saturated pixel was given, over the count that clips.
    notes
        What was done to make it fit the sensor.
    warnings
        What a person should know.
    """

    psf: Tensor
    channels: tuple[str, ...]
    merged: int
    background: tuple[float, ...]
    black_stated: bool
    saturated_fraction: float
    raised: float
    notes: tuple[str, ...] = field(default=())
    warnings: tuple[str, ...] = field(default=())

    def figures(self) -> dict[str, Any]:
        """Figures in values that JSON has."""
        return {
            "pixels": list(self.psf.shape[-2:]),
            "background_counts": [round(each, 2) for each in self.background],
            "black_stated": self.black_stated,
            "saturated_fraction": self.saturated_fraction,
            "saturated_raised": round(self.raised, 3),
            "notes": list(self.notes),
        }


def import_psf(
    frame: Frame,
    *,
    dark: Frame | None = None,
    flat: Frame | None = None,
    black: BlackLevel = None,
    white: float | None = None,
    channels: str = "all",
    bin_by: int = 1,
    sensor: tuple[int, int] | None = None,
    partial: bool = False,
    wide: bool = False,
) -> PsfImport:
    """Make a finished PSF fit a camera, with no more done to it than that.

    A black level that nobody states is read off the area that an aperture keeps dark
    (`stray_light`). Saturated pixels are continued from around them (`continued`).

    Parameters
    ----------
    frame
        The PSF; its middle pixel (rows // 2, columns // 2) is the zero shift.
    dark, flat, black, white, channels, bin_by
        As `develop` takes them; a black level ``"auto"`` is read off the darkest corner. Without
        `white`, very many pixels of just the largest count are taken for saturated.
    sensor
        (rows, columns) of the camera in pixels of the PSF: one that is smaller gets dark pixels
        around its middle, and what is larger in one direction is cut. None takes the PSF's own.
    partial
        The PSF may be smaller than the sensor in both directions: its dark sides were cut off.
    wide
        The PSF is known beyond the sensor, and keeps its size.

    Raises
    ------
    DataError
        If it cannot be developed, shows no light, or is not on the sensor's pixels.
    OptionError
        If an option of `develop` cannot be used.
    """
    level = saturation_count(frame) if white is None else white
    developed = develop(
        frame,
        dark=dark,
        flat=flat,
        black=black_level(black, frame),
        white=level,
        channels=channels,
        bin_by=bin_by,
    )
    values, background = developed.values, torch.zeros(len(developed.values))
    known = black_is_known(developed, values)
    area = None if developed.black_stated else dark_area(values)
    if area is not None:
        light = stray_light(values, area)
        background = light.mean(dim=(-2, -1))
        if float((background / values.mean(dim=(-2, -1))).max()) > _NO_BACKGROUND:
            values, known = values - light, True
        else:
            background = torch.zeros_like(background)
    clipped = ~developed.valid
    saturated = float(clipped.float().mean(dim=(-2, -1)).max())
    full = torch.stack([continued(*each) for each in zip(values, clipped, strict=True)])
    tops = values.amax(dim=(-2, -1)), full.amax(dim=(-2, -1))
    checked = replace(
        developed, values=full, valid=torch.ones_like(developed.valid), black_stated=known
    )
    warnings = [*check_psf(checked, full), *_saturation_warnings(developed, saturated)]
    # A black level that is still there would make the contrast of any PSF low.
    other = no_point_source(full if known else full - darkest_corner(full), frame.source)
    if other is not None:
        warnings.append(
            f"{other}. Give a picture of a small light, such as an LED behind a pinhole, in a dark "
            "room; what the sensor measured of a scene is for nolens reconstruct"
        )
    notes: tuple[str, ...] = ()
    psf = full
    if sensor is not None and not wide:
        psf, notes = _on_sensor(full, sensor, frame.source, partial=partial)
    return PsfImport(
        psf,
        developed.channels,
        bin_by * (1 if frame.mosaic is None else 2),
        tuple(background.tolist()),
        developed.black_stated,
        saturated,
        float((tops[1] / tops[0]).max()),
        notes,
        tuple(warnings),
    )


def continued(plane: Tensor, clipped: Tensor) -> Tensor:
    r"""Continue a PSF smoothly over the pixels where it is clipped.

    Over them the logarithm :math:`u = \ln(h + ε)` is the smoothest that the pixels around leave,
    :math:`\min_u ‖Δu‖^2` (biharmonic inpainting, as `damelin2018`): from its slopes a peak goes on
    like a Gaussian. It is held between the value that clips and four times that.

    Parameters
    ----------
    plane
        (rows, columns), without black level.
    clipped
        Bool, of the same shape: where the value is only the least that it may be.
    """
    top = float(plane.max())
    if not bool(clipped.any()) or not top > 0:
        return plane
    offset = _OFFSET * top
    log = (plane.double().clamp_min(0) + offset).log().numpy()
    least = log[clipped.numpy()]
    start = np.full_like(least, np.log(top + offset))
    unknown, fixed = _laplacian(clipped.numpy(), log)
    result = lsmr(unknown, -fixed, x0=start, atol=_TOLERANCE, btol=_TOLERANCE, maxiter=_MOST_STEPS)[
        0
    ]
    most = np.log(_MOST_ABOVE * top + offset)
    filled = plane.clone()
    filled[clipped] = torch.from_numpy(np.exp(result.clip(least, most)) - offset).to(plane.dtype)
    return filled


def _laplacian(
    clipped: NDArray[np.bool_], values: NDArray[np.float64]
) -> tuple[sparse.csr_matrix, NDArray[np.float64]]:
    """Laplacian at all pixels whose neighbours are clipped: its matrix for those, and the rest.

    A neighbour beyond the edge counts as the pixel itself.
    """
    rows, columns = clipped.shape
    down, right = ndimage.binary_dilation(clipped).nonzero()
    number = np.full(clipped.shape, -1)
    number[clipped] = np.arange(int(clipped.sum()))
    places, entries, weights = [], [], []
    fixed = np.zeros(len(down))
    lines = np.arange(len(down))
    for step in ((-1, 0), (1, 0), (0, -1), (0, 1)):
        beside = (down + step[0]).clip(0, rows - 1), (right + step[1]).clip(0, columns - 1)
        for (row, column), sign in ((beside, 1.0), ((down, right), -1.0)):
            inside = clipped[row, column]
            places.append(lines[inside])
            entries.append(number[row, column][inside])
            weights.append(np.full(int(inside.sum()), sign))
            fixed += np.where(inside, 0.0, sign * values[row, column])
    matrix = sparse.coo_matrix(
        (np.concatenate(weights), (np.concatenate(places), np.concatenate(entries))),
        shape=(len(down), int(clipped.sum())),
    )
    return matrix.tocsr(), fixed


def _saturation_warnings(psf: Measurement, fraction: float) -> list[str]:
    if fraction <= _UNRELIABLE:
        return []
    return [
        f"{100 * fraction:.2g} % of the PSF {psf.source} is saturated, and what is put there is a "
        "guess: pictures come out poor. A shorter exposure of the point source, or a PSF solved "
        "from known pictures (nolens calibrate pairs), gives better ones"
    ]


def _on_sensor(
    psf: Tensor, sensor: tuple[int, int], source: str, *, partial: bool
) -> tuple[Tensor, tuple[str, ...]]:
    """The PSF cut or with dark pixels around it, its zero shift in the middle; what was done."""
    have = psf.shape[-2], psf.shape[-1]
    if have == sensor:
        return psf, ()
    sizes = f"{source} has {have[0]}×{have[1]} pixels, and the sensor {sensor[0]}×{sensor[1]}"
    if have == sensor[::-1]:
        raise DataError(f"{sizes}: it is turned by 90°. Turn it back")
    if all(mine > its for mine, its in zip(have, sensor, strict=True)):
        factor = have[0] // sensor[0]
        finer = (have[0] // factor, have[1] // factor) == sensor and factor > 1
        reading = f"finer (--bin {factor})" if finer else "finer (--bin N; no N fits these sizes)"
        raise DataError(
            f"{sizes}: it is either {reading}, or extended, with light beyond the sensor too "
            "(--psf-extent wide). Say which"
        )
    if all(mine < its for mine, its in zip(have, sensor, strict=True)) and not partial:
        factor = sensor[0] // have[0]
        binned = (sensor[0] // factor, sensor[1] // factor) == have
        raise DataError(
            f"{sizes}: it was {f'binned by {factor}' if binned else 'binned'}, cut, or is another "
            f"camera's. If its dark sides were cut off, say so (--sensor {sensor[0]}x{sensor[1]})"
        )
    sides, texts = [], []
    for mine, its, what in zip(have, sensor, ("rows", "columns"), strict=True):
        before = its // 2 - mine // 2
        sides.append((before, its - mine - before))
        if mine < its:
            texts.append(f"{its - mine} dark {what} are added")
        elif mine > its:
            texts.append(f"{mine - its} {what} are cut off")
    note = f"{sizes}: {' and '.join(texts)} around its middle"
    return nnf.pad(psf, (*sides[1], *sides[0])).contiguous(), (note,)
