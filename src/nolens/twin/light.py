"""The colour of light: spectra, and the few wavelengths that stand for one channel of a sensor."""

import re
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from nolens.camera import SpectralCurve
from nolens.camera.spectra import colour_matching
from nolens.errors import OptionError
from nolens.quantities import Angle, Length

Colour = tuple[tuple[float, float], ...]
"""Wavelengths in nm that stand for a channel of a sensor, each with its weight."""
LIGHTS = ("white-led", "daylight", "equal-energy")
"""Spectra with a name."""
POWER = "power"
"""Name of the values of a spectrum."""
_STEP_NM = 1.0
_VISIBLE_NM = np.arange(360.0, 831.0, _STEP_NM)
_DAYLIGHT_K = 6504.0
_SECOND_RADIATION_NM_K = 1.438777e7
_LUMENS_PER_WATT = 683.0
_PLANCK_LIGHT_J_M = 6.62607015e-34 * 299792458.0


@dataclass(frozen=True)
class Light:
    """Spectrum of a source.

    Parameters
    ----------
    name
        One of `LIGHTS`, one wavelength such as ``"535nm"``, or with a `spectrum` what that is
        called. ``white-led`` is a placeholder:
        a blue line at 450 nm (20 nm wide at half height) and a phosphor at 560 nm (120 nm wide)
        of half its height, a usual shape without a public source. ``daylight`` is Planck's law
        at 6504 K, ``equal-energy`` the same power at all wavelengths.
    spectrum
        Power to the nm over wavelength, of `POWER`, 1 at most: such as an emission spectrum.

    Raises
    ------
    OptionError
        If the name is neither.
    """

    name: str
    spectrum: SpectralCurve | None = None

    def __post_init__(self) -> None:
        if self.spectrum is None and self.name not in LIGHTS and self.single_nm is None:
            raise OptionError(
                f"unknown light {self.name!r}; accepted are {', '.join(LIGHTS)}, or one "
                "wavelength of 350 to 1100 nm such as 535nm"
            )

    @property
    def single_nm(self) -> float | None:
        """The wavelength of monochromatic light; None for a spectrum."""
        if self.spectrum is not None:
            return None
        match = re.fullmatch(r"([0-9]+(?:\.[0-9]+)?)\s*nm", self.name)
        if match is None or not 350 <= float(match[1]) <= 1100:
            return None
        return float(match[1])

    def power(self, wavelength_nm: NDArray[np.float64]) -> NDArray[np.float64]:
        """Power to the nm at some wavelengths, in any unit; for spectra."""
        if self.spectrum is not None:
            return self.spectrum.at(POWER, wavelength_nm)
        if self.name == "white-led":
            blue, phosphor = (
                _line(wavelength_nm, at, width) for at, width in ((450, 20), (560, 120))
            )
            return blue + 0.5 * phosphor
        if self.name == "daylight":
            scaled = wavelength_nm / 560.0
            return scaled**-5 / np.expm1(_SECOND_RADIATION_NM_K / (wavelength_nm * _DAYLIGHT_K))
        return np.ones_like(wavelength_nm)

    def wavelengths(self, efficiency: SpectralCurve, channel: str, count: int) -> Colour:
        r"""Wavelengths that stand for this light in a channel, and their weights.

        Nodes of Gauss's quadrature for the weight function :math:`S(λ)\,λ\,Q(λ)`: photons of
        the source times quantum efficiency. `count` of them integrate polynomials of degree
        2·count − 1 exactly (`golub1969`).

        Parameters
        ----------
        efficiency, channel
            Of the sensor, filters included, and one of its channels.
        count
            How many wavelengths. The sum of their weights is 1.

        Raises
        ------
        OptionError
            If the channel sees nothing of this light.
        """
        if self.single_nm is not None:
            return ((self.single_nm, 1.0),)
        grid = self._grid(efficiency)
        weight = self.power(grid) * grid * efficiency.at(channel, grid)
        if not weight.sum() > 0:
            raise OptionError(
                f"the sensor's channel {channel} sees nothing of the light {self.name}: its "
                f"quantum efficiency is zero wherever that shines; choose {', '.join(LIGHTS)}"
            )
        weight = weight / weight.sum()
        nodes, weights = _gauss(grid, weight, min(count, int(np.count_nonzero(weight))))
        return tuple(zip(nodes.tolist(), weights.tolist(), strict=True))

    def colours(
        self, efficiency: SpectralCurve, channels: tuple[str, ...], count: int
    ) -> list[Colour]:
        """`wavelengths` of several channels."""
        return [self.wavelengths(efficiency, channel, count) for channel in channels]

    def electrons(self, efficiency: SpectralCurve, channel: str, luminance_cd_m2: float) -> float:
        r"""Electrons that a pixel frees in a second for its area and the solid angle of light.

        :math:`\int L(λ)\,\frac{λ}{hc}\,Q(λ)\,dλ` in 1/(m² sr s), with the spectral radiance L
        that has the luminance :math:`683\,\mathrm{lm/W}\int L V\,dλ`; the eye's V is the sum of
        two Gaussians of `wyman2013`.

        Parameters
        ----------
        efficiency, channel
            As for `wavelengths`.
        luminance_cd_m2
            Of the surface that shines.
        """
        single = self.single_nm
        if single is not None:
            # A line too thin for the eye to weigh: taken as bright as at the eye's best.
            grid, power = np.array([single]), np.array([luminance_cd_m2 / _LUMENS_PER_WATT])
        else:
            grid = self._grid(efficiency)
            power = self.power(grid)
            lumens = (
                float((self.power(_VISIBLE_NM) * colour_matching(_VISIBLE_NM)[1]).sum())
                * _LUMENS_PER_WATT
            )
            power = power * (luminance_cd_m2 / lumens)
        photons = power * grid * 1e-9 / _PLANCK_LIGHT_J_M
        return float((photons * efficiency.at(channel, grid)).sum())

    def _grid(self, efficiency: SpectralCurve) -> NDArray[np.float64]:
        first, last = efficiency.wavelength_nm[0], efficiency.wavelength_nm[-1]
        return np.arange(first, last + _STEP_NM / 2, _STEP_NM)


@dataclass(frozen=True)
class Band:
    """A slice of a scene: its light of one wavelength, or what is polarised at one angle.

    Parameters
    ----------
    place
        The wavelength, or the angle as `Polariser` counts it.
    """

    place: Length | Angle

    def light(self, otherwise: Light) -> Light:
        """Its spectrum; that of polarised light is `otherwise`."""
        nm = self.wavelength_nm
        return otherwise if nm is None else Light(f"{nm:.12g}nm")

    @property
    def wavelength_nm(self) -> float | None:
        """Its wavelength; None of polarised light."""
        return self.place.um * 1e3 if isinstance(self.place, Length) else None

    @property
    def polarisation(self) -> Angle | None:
        """Its angle; None of a wavelength."""
        return self.place if isinstance(self.place, Angle) else None


def _line(
    wavelength_nm: NDArray[np.float64], centre_nm: float, width_nm: float
) -> NDArray[np.float64]:
    shape: NDArray[np.float64] = np.exp2(-((2 * (wavelength_nm - centre_nm) / width_nm) ** 2))
    return shape


def _gauss(
    grid: NDArray[np.float64], weight: NDArray[np.float64], count: int
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Nodes and weights of Gauss's quadrature for a weight on a grid, by Lanczos' recurrence."""
    middle, half = (grid[0] + grid[-1]) / 2, (grid[-1] - grid[0]) / 2
    x = (grid - middle) / half
    basis = [np.sqrt(weight)]
    diagonal, beside = [], []
    for step in range(count):
        diagonal.append(float(basis[-1] @ (x * basis[-1])))
        if step + 1 == count:
            break
        rest = x * basis[-1]
        for _ in range(2):  # Twice is enough against rounding.
            for each in basis:
                rest = rest - each * (each @ rest)
        beside.append(float(np.linalg.norm(rest)))
        basis.append(rest / beside[-1])
    matrix = np.diag(diagonal) + np.diag(beside, 1) + np.diag(beside, -1)
    nodes, vectors = np.linalg.eigh(matrix)
    return middle + half * nodes, vectors[0] ** 2
