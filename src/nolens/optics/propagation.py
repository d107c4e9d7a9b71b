"""A field through plane layers, by one transfer function for all of them."""

import math

import torch
from torch import Tensor

from nolens.kernels import LayerTransfer, apply_transfer_, fft2_, ifft2_window
from nolens.kernels.fft import Window
from nolens.optics.layers import Stack


def propagate(
    field: Tensor,
    pitch_um: float,
    stack: Stack,
    wavelength_um: float,
    *,
    carrier: tuple[float, float] = (0.0, 0.0),
    offset_um: tuple[float, float] = (0.0, 0.0),
    band_per_um: float = math.inf,
    surfaces: tuple[float, ...] = (),
    finer: int = 1,
    window: Window | None = None,
    squared: bool = False,
) -> Tensor:
    r"""Field behind a stack of layers, in the frame of the chief ray.

    The field is :math:`u(x)\,e^{ik_0 p_c·x}`, of which only u is sampled. Transverse frequency is
    conserved, so the layers multiply its spectrum at f by :math:`e^{iΦ(p_c + λf)}` with
    :math:`Φ(p) = k_0 Σ_j t_j\sqrt{n_j^2 - |p|^2}`, the angular spectrum method (`goodman2005`).
    The value and the slope of Φ at the carrier are taken out: what is left are the samples
    around the place where the chief ray arrives. They are computed in float64. Frequencies
    outside the band are dropped, as light of theirs would leave the window and come back at
    its other side (`matsushima2009`).

    Parameters
    ----------
    field
        complex64, (rows, columns); its memory may be used again.
    pitch_um
        Distance of the samples.
    stack
        The layers.
    wavelength_um
        In vacuum.
    carrier
        p = n sin θ of the plane wave that is taken out, (row, column) direction.
    offset_um
        Place of the result's samples, from where the chief rays of the field's samples arrive.
    band_per_um
        Largest frequency that is retained.
    surfaces
        Refractive indices of the media that the light goes through, if Fresnel's losses at the
        surfaces between them count.
    finer
        Number of samples to give for one, in either direction.
    window
        Part of the result that is needed; None for all of it.
    squared
        Whether to give |u|² in place of u.

    Returns
    -------
    Tensor
        complex64 or float32, (finer · rows, finer · columns), or of the window's size.
    """
    spectrum = pass_layers_(
        fft2_(field),
        pitch_um,
        stack,
        wavelength_um,
        carrier=carrier,
        offset_um=offset_um,
        band_per_um=band_per_um,
        surfaces=surfaces,
    )
    rows, columns = (finer * count for count in spectrum.shape)
    return ifft2_window(spectrum, window or (0, 0, rows, columns), finer, squared=squared)


def pass_layers_(
    spectrum: Tensor,
    pitch_um: float,
    stack: Stack,
    wavelength_um: float,
    *,
    carrier: tuple[float, float] = (0.0, 0.0),
    offset_um: tuple[float, float] = (0.0, 0.0),
    band_per_um: float = math.inf,
    surfaces: tuple[float, ...] = (),
) -> Tensor:
    """Multiply a field's spectrum, complex64, by the transfer function of layers, in place.

    All other parameters are those of `propagate`.
    """
    frequency = [torch.fft.fftfreq(n, pitch_um, dtype=torch.float64) for n in spectrum.shape]
    p = [c + wavelength_um * f for c, f in zip(carrier, frequency, strict=True)]
    squared = carrier[0] ** 2 + carrier[1] ** 2
    central = torch.tensor(squared, dtype=torch.float64)
    # The slope of Φ/k₀ is −displacement along p; displacement / p stays finite at p = 0.
    size = math.sqrt(squared)
    ratio = float(stack.displacement_um(central.sqrt())) / size if size > 0 else stack.reduced_um
    linear = [
        (ratio * c + offset) * f for c, offset, f in zip(carrier, offset_um, frequency, strict=True)
    ]
    linear[0] = linear[0] - float(stack.axial_um(central)) / wavelength_um
    limit = min((stack.critical, *surfaces)) ** 2
    passed = [q.where(f.abs() <= band_per_um, math.inf) for q, f in zip(p, frequency, strict=True)]
    transfer = LayerTransfer(
        (passed[0].to(spectrum.device), passed[1].to(spectrum.device)),
        (linear[0].to(spectrum.device), linear[1].to(spectrum.device)),
        tuple(t / wavelength_um for t in stack.thicknesses_um),
        tuple(n * n for n in stack.indices),
        limit,
        surfaces,
    )
    return apply_transfer_(spectrum, transfer)
