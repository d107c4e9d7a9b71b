"""Figures of a point spread function, as the paper's Fig. 5 shows them."""

import math
from dataclasses import dataclass

from torch import Tensor

from nolens.errors import DataError
from nolens.evaluate.psf_figures_autocorrelation import Autocorrelation
from nolens.evaluate.psf_figures_spectrum import DIRECTIONS_DEG, Spectrum
from nolens.evaluate.spectral_magnitude import sparsity

_SMALLEST = 16


@dataclass(frozen=True)
class PsfFigures:
    """How fine, how dense and how clear a PSF is.

    Parameters
    ----------
    cell_um
        Distance of its cells.
    fwhm_um
        Full width of the autocorrelation, all directions averaged, half way between its peak and
        the lowest value before the second peak: that of one spot, where spots do not touch.
    fwhm_over_mean_um
        The same half way between the peak and zero, the mean taken off, as
        `nolens.evaluate.pattern_figures` has it.
    row_fwhm_um
        `fwhm_um` along the rows alone, the one line that the paper draws.
    line_width_um
        `fwhm_um` / √2: of a line or spot with a Gaussian profile (`uvimprint`).
    pitch_um, row_pitch_um
        From the first to the second peak of the autocorrelation, in all directions and along the
        rows; None where there is no second peak.
    background_share
        Share of the light that lies evenly under the pattern (see `background_of`).
    contrast
        Standard deviation over mean (`peli1990`), the noise's share taken off.
    sparsity
        Share of the area without light, see `nolens.evaluate.sparsity`; noise taken off.
    noise
        Standard deviation of a cell's noise, in the PSF's unit.
    noise_given
        Whether that was given; otherwise it is the power at the frequencies where it is least.
    noise_magnitude
        What this noise is as spectral magnitude.
    clear_bands_per_mm
        Spatial frequencies, from and to, at which the PSF has more power than noise, up to that of
        two cells; gaps and bands of less than 0.02 cycles to the cell are passed over.
    usable_per_mm
        End of the first of these bands, from which on the PSF sinks into its noise; 0 where there
        is none.
    line_per_mm
        Frequency of which half a period is a line's width.
    lowest_magnitude
        Smallest magnitude, all directions averaged, up to `line_per_mm`.
    line_deg, usable_deg
        Angles in the scene that are as wide on the sensor as a line, and as half a period of
        `usable_per_mm`; None without a reduced thickness.
    lag_um, autocorrelation, row_autocorrelation
        Autocorrelation without the mean by distance, 1 at zero.
    level
        Of its lowest value before the second peak.
    per_mm, magnitude
        Spectral magnitude over all directions by spatial frequency: root mean square of the
        spectrum over rings, of the light without its background. It scales with one over the root
        of the number of spots, so it is no modulation transfer.
    direction_magnitude
        For 0, 90, 180 and 270°, pairs of frequency and magnitude. A real pattern has the same
        spectrum at 0 and 180°, whatever it is.
    """

    cell_um: float
    fwhm_um: float
    fwhm_over_mean_um: float
    row_fwhm_um: float | None
    line_width_um: float
    pitch_um: float | None
    row_pitch_um: float | None
    background_share: float
    contrast: float
    sparsity: float
    noise: float
    noise_given: bool
    noise_magnitude: float
    clear_bands_per_mm: tuple[tuple[float, float], ...]
    usable_per_mm: float
    line_per_mm: float
    lowest_magnitude: float
    line_deg: float | None
    usable_deg: float | None
    lag_um: tuple[float, ...]
    autocorrelation: tuple[float, ...]
    row_autocorrelation: tuple[float, ...]
    level: float
    per_mm: tuple[float, ...]
    magnitude: tuple[float, ...]
    direction_magnitude: dict[int, tuple[tuple[float, ...], tuple[float, ...]]]


def psf_figures(
    psf: Tensor, cell_um: float, *, reduced_um: float | None = None, noise: float | None = None
) -> PsfFigures:
    r"""Measure a PSF (`uvimprint`, fig. 5).

    The light's angle in the scene is its length on the sensor over the reduced thickness
    :math:`D = Σ t/n` of what lies behind the mask.

    Parameters
    ----------
    psf
        (rows, columns), linear, without black level, in any unit.
    cell_um
        Distance of its cells.
    reduced_um
        D; None: angles are not told.
    noise
        Standard deviation of a cell's noise; None has it estimated, see `Spectrum.of`.

    Raises
    ------
    DataError
        If the PSF is dark, even or all noise, smaller than 16 cells, or its lines are wider than
        half of it.
    """
    if min(psf.shape) < _SMALLEST:
        raise DataError(
            f"a PSF of {psf.shape[0]}×{psf.shape[1]} cells is too small to measure: "
            f"{_SMALLEST}×{_SMALLEST} at least"
        )
    mean = float(psf.double().mean())
    if not mean > 0:
        raise DataError("the PSF is dark: it has no light to measure")
    spectrum = Spectrum.of(psf, noise)
    variance = float((spectrum.power * spectrum.weight).sum()) / spectrum.cells**2
    if not variance > 1e-12 * mean**2:
        raise DataError("the pattern is even: it has no lines to measure")
    if not variance > spectrum.noise**2 or not spectrum.total > 0:
        raise DataError(
            f"the PSF varies by {math.sqrt(variance):.4g}, no more than its noise of "
            f"{spectrum.noise:.4g}: it has no lines to measure"
        )
    variance -= spectrum.noise**2
    found = Autocorrelation.of(psf, spectrum.background, spectrum.noise)
    level = found.level()
    width, over_mean = found.width(found.radial, level), found.width(found.radial, 0.0)
    if width is None or over_mean is None:
        raise DataError("the pattern is too small to measure: its lines are wider than half of it")
    line_um = width * cell_um / math.sqrt(2)
    pitches = [
        found.pitch(profile, level, spread=spread)
        for profile, spread in ((found.radial, True), (found.row, False))
    ]
    row = found.width(found.row, level)
    to_mm = 1e3 / cell_um
    at, magnitude = spectrum.magnitude()
    line_per_mm = 500 / line_um
    below = magnitude[at * to_mm <= line_per_mm]
    bands = tuple((low * to_mm, high * to_mm) for low, high in spectrum.clear_bands())
    usable = bands[0][1] if bands else 0.0
    directions = {angle: spectrum.magnitude(angle) for angle in DIRECTIONS_DEG}
    return PsfFigures(
        cell_um=cell_um,
        fwhm_um=width * cell_um,
        fwhm_over_mean_um=over_mean * cell_um,
        row_fwhm_um=None if row is None else row * cell_um,
        line_width_um=line_um,
        pitch_um=None if pitches[0] is None else pitches[0] * cell_um,
        row_pitch_um=None if pitches[1] is None else pitches[1] * cell_um,
        background_share=spectrum.background / mean,
        contrast=math.sqrt(variance) / mean,
        sparsity=sparsity(psf, spectrum.noise),
        noise=spectrum.noise,
        noise_given=noise is not None,
        noise_magnitude=math.sqrt(spectrum.noise_power) / spectrum.total,
        clear_bands_per_mm=bands,
        usable_per_mm=usable,
        line_per_mm=line_per_mm,
        lowest_magnitude=float(below.min()) if len(below) else float(magnitude[0]),
        line_deg=_angle_deg(line_um, reduced_um),
        usable_deg=_angle_deg(500 / usable, reduced_um) if usable else None,
        lag_um=_told(found.lag * cell_um),
        autocorrelation=_told(found.radial),
        row_autocorrelation=_told(found.row),
        level=level,
        per_mm=_told(at * to_mm),
        magnitude=_told(magnitude),
        direction_magnitude={
            angle: (_told(each * to_mm), _told(values))
            for angle, (each, values) in directions.items()
        },
    )


def _angle_deg(length_um: float, reduced_um: float | None) -> float | None:
    return None if reduced_um is None else math.degrees(math.atan(length_um / reduced_um))


def _told(values: Tensor) -> tuple[float, ...]:
    return tuple(values.tolist())
