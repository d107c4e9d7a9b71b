"""How good a photograph is, and what a PSF is like."""

from torch import Tensor

from nolens.api.image import Image
from nolens.api.inputs import length_um
from nolens.camera import Frame, develop
from nolens.errors import DataError
from nolens.evaluate import PsfFigures, psf_figures, scale_fit
from nolens.evaluate import psnr as _psnr
from nolens.evaluate import ssim as _ssim
from nolens.quantities import Length
from nolens.solvers.inputs import Plane, channels_of


def psnr(picture: Image | Plane, truth: Image | Plane) -> float:
    """Peak signal-to-noise ratio in dB after the one factor that fits best.

    Parameters
    ----------
    picture, truth
        Linear, (channels, height, width), of one size. The peak is the truth's.

    Raises
    ------
    DataError
        If their sizes differ.
    """
    fitted, values = _fitted(picture, truth)
    return _psnr(fitted, values, float(values.max()))


def ssim(picture: Image | Plane, truth: Image | Plane) -> float:
    """Structural similarity, as `psnr` takes its pictures (`wang2004`).

    Raises
    ------
    DataError
        If their sizes differ.
    """
    fitted, values = _fitted(picture, truth)
    return _ssim(fitted, values, float(values.max()))


def measure_psf(psf: Image | Frame | Plane, pixel: str | Length, *, channel: int = 0) -> PsfFigures:
    """Width of the lines, pitch, contrast, sparsity and spectrum of a PSF (`psf_figures`).

    Parameters
    ----------
    psf
        A PSF, a raw frame of one, or linear values, (channels, height, width).
    pixel
        Distance of its pixels, such as ``"3.1um"``; of a raw mosaic, that of the superpixels.
    channel
        Which one is measured.

    Raises
    ------
    DataError
        If it shows nothing that can be measured.
    """
    values = develop(psf).values if isinstance(psf, Frame) else _values(psf, "PSF")
    if not 0 <= channel < values.shape[0]:
        raise DataError(f"channel is {channel}; the PSF has {values.shape[0]}, counted from 0")
    return psf_figures(values[channel], length_um(pixel))


def _fitted(picture: Image | Plane, truth: Image | Plane) -> tuple[Tensor, Tensor]:
    shown, values = _values(picture, "picture"), _values(truth, "truth")
    if shown.shape != values.shape:
        raise DataError(
            f"the picture is {tuple(shown.shape)} and the truth {tuple(values.shape)}, (channels, "
            "height, width): give both of one size"
        )
    return scale_fit(shown, values), values


def _values(given: Image | Plane, what: str) -> Tensor:
    return (given.values if isinstance(given, Image) else channels_of(given, what)).float().cpu()
