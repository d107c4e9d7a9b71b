"""How sharp a PSF is, in one figure: of the PSF itself, or of a model of its spots."""

import math
import re
from dataclasses import dataclass
from typing import Annotated, Literal

import torch
from pydantic import ConfigDict, Field, RootModel
from torch import Tensor

from nolens.errors import DataError, OptionError
from nolens.evaluate import pattern_figures, spectral_magnitude
from nolens.quantities import Length, Percentage

_MTF = re.compile(r"mtf@([0-9]+(?:\.[0-9]*)?|\.[0-9]+)\s*/\s*mm")
_FWHM = math.sqrt(8 * math.log(2))
_ORDERS = 12
_TIMES = re.compile(r"\s*([0-9]+(?:\.[0-9]*)?|\.[0-9]+)\s*[x×]\s*")


@dataclass(frozen=True)
class Sharpness:
    """A criterion.

    Parameters
    ----------
    kind
        ``"line-width"``: width at half height of a line of the PSF, in um, which the paper
        takes for the width of the autocorrelation divided by √2 (`uvimprint`, fig. 5b).
        ``"contrast"``: standard deviation over mean, in %. ``"mtf"``: modulation transfer of one
        lenslet's spot at a frequency, in %.
    per_mm
        The frequency, for ``"mtf"``.
    """

    kind: Literal["line-width", "contrast", "mtf"]
    per_mm: float = 0.0

    @classmethod
    def parse(cls, text: str) -> "Sharpness":
        """Read a criterion such as ``line-width``, ``contrast`` or ``mtf@40/mm``.

        Raises
        ------
        OptionError
            If it is another text.
        """
        if text == "line-width":
            return cls("line-width")
        if text == "contrast":
            return cls("contrast")
        match = _MTF.fullmatch(text.strip())
        if match is None or not 0 < float(match[1]) < 1e5:
            raise OptionError(
                f"criterion {text!r} is unknown: give line-width, contrast, or mtf@ and a "
                "frequency such as mtf@40/mm"
            )
        return cls("mtf", float(match[1]))

    @property
    def smaller_is_better(self) -> bool:
        """Whether a smaller figure means a sharper PSF."""
        return self.kind == "line-width"

    @property
    def name(self) -> str:
        """The criterion as `parse` reads it."""
        return f"mtf@{self.per_mm:g}/mm" if self.kind == "mtf" else self.kind

    @property
    def unit(self) -> str:
        """Unit of the figure."""
        return "um" if self.kind == "line-width" else "%"

    def check(self, pixel_um: float, pitch_um: float) -> None:
        """Refuse a frequency that shows the arrangement of the lenslets rather than one of them.

        Parameters
        ----------
        pixel_um
            Distance of the sensor's pixels.
        pitch_um
            Of the lenslets.

        Raises
        ------
        OptionError
            If it is below the lenslets' own or beyond what the pixels show.
        """
        lowest, highest = 1e3 / pitch_um, 5e2 / pixel_um
        if self.kind == "mtf" and not lowest <= self.per_mm <= highest:
            raise OptionError(
                f"{self.name}: between the lenslets' own frequency and the finest that "
                f"pixels of {pixel_um:g} µm show, give {math.ceil(lowest)}/mm to "
                f"{math.floor(highest)}/mm"
            )

    def of_psf(self, psf: Tensor, pixel_um: float, lenslets: float) -> float:
        r"""Figure of a PSF.

        The modulation transfer is that of `lenslets` spots in random places, whose spectra add
        like random numbers: :math:`\sqrt{N/a}` times `nolens.evaluate.spectral_magnitude` for N
        of them on an area a in mm².

        Parameters
        ----------
        psf
            (rows, columns), in any unit.
        pixel_um
            Pitch of its pixels.
        lenslets
            How many have made it.

        Returns
        -------
        float
            Infinite where the PSF has no lines to measure.
        """
        if self.kind == "line-width":
            try:
                return pattern_figures(psf, pixel_um).width_um / math.sqrt(2)
            except DataError:
                return math.inf
        if self.kind == "contrast":
            values = psf.double()
            return 100 * float(values.std(correction=0) / values.mean())
        area_mm2 = math.prod(psf.shape) * (pixel_um * 1e-3) ** 2
        whole = spectral_magnitude(psf, pixel_um, self.per_mm)
        return 100 * whole * math.sqrt(lenslets / area_mm2)

    def of_spots(self, sigma_um: Tensor, pitch_um: Tensor, gathered: float) -> Tensor:
        r"""Figure of Gaussian spots on a hexagonal arrangement, over an even background.

        Width :math:`\sqrt{8 \ln 2}\,σ`; modulation :math:`η\,e^{-2π^2σ^2f^2}`; and the contrast
        is η times the root of the sum of :math:`e^{-4π^2σ^2G^2}` over all orders G of the
        arrangement but the zeroth.

        Parameters
        ----------
        sigma_um
            Standard deviation of a spot along one axis.
        pitch_um
            Distance of neighbouring spots; of the same shape.
        gathered
            Fraction η of the light that is in the spots.
        """
        if self.kind == "line-width":
            return _FWHM * sigma_um
        if self.kind == "mtf":
            return 100 * gathered * torch.exp(-2 * (math.pi * sigma_um * self.per_mm * 1e-3) ** 2)
        orders = torch.arange(-_ORDERS, _ORDERS + 1, dtype=torch.float64)
        squared = (orders[:, None] ** 2 + orders[:, None] * orders + orders**2).flatten()
        squared = squared[squared > 0] * (4 / 3)
        exponent = -4 * (math.pi * sigma_um / pitch_um)[..., None] ** 2 * squared
        return 100 * gathered * exponent.exp().sum(-1).sqrt()


class Limit(RootModel[Annotated[str, Field(max_length=40)]]):
    """What a good camera meets: a length, a fraction, or so many times the nominal figure."""

    model_config = ConfigDict(frozen=True)

    def __str__(self) -> str:
        return self.root

    def value(self, sharpness: Sharpness, nominal: float) -> float:
        """The limit in the criterion's unit.

        Parameters
        ----------
        sharpness
            The criterion.
        nominal
            Its figure with every parameter in its middle.

        Raises
        ------
        OptionError
            If the text is no limit for this criterion.
        """
        times = _TIMES.fullmatch(self.root)
        if times is not None:
            limit = float(times[1]) * nominal
        else:
            kind = Length if sharpness.unit == "um" else Percentage
            try:
                limit = kind.parse(self.root).to(sharpness.unit)
            except OptionError as error:
                raise OptionError(
                    f"--limit: {error}; or give it as a multiple of the nominal figure, such as "
                    "1.2x"
                ) from None
        if not limit > 0:
            raise OptionError(f"--limit {self} is not more than zero: nothing meets it")
        return limit
