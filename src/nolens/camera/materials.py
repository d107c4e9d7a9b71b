"""Transparent materials that layers of a camera are made of."""

import math
import tomllib
from collections.abc import Mapping
from importlib.resources import files
from typing import Annotated, Any, Literal, Self

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, field_validator, model_validator

from nolens.camera.part import Number, Part, Text, Wavelength, refusal
from nolens.errors import OptionError
from nolens.printable import suggestion
from nolens.ranges import Between

Array = NDArray[np.float64]

_LINES_NM = {"F": 486.13, "d": 587.56, "C": 656.27}
"""Fraunhofer lines that glass is known by."""

_BUILT_IN = (
    "air",
    "pua311",
    "pdms",
    "sylgard184",
    "noa61",
    "polycarbonate",
    "pmma",
    "cover-glass",
    "d263",
    "bk7",
    "fused-silica",
)
_LOWEST, _HIGHEST = 1.0, 4.0
_PROBES = 1000
_TABLE_NM = (400, 450, 500, 535, 550, 600, 620, 650, 700, 850)
_DIGITS = 6


class Material(Part):
    r"""A transparent material: its refractive index over wavelength, and what a maker must know.

    With the wavelength in vacuum λ in µm the formulas are

    ============ =========================================== ==============================
    formula      index                                       coefficients
    ============ =========================================== ==============================
    constant     :math:`n = n_0`                             n_0
    abbe         :math:`n = A + B/λ^2`                       n_d, V_d
    cauchy       :math:`n = A + B/λ^2 + C/λ^4 + …`           A, B, C, …
    sellmeier    :math:`n^2 = 1 + \sum_i B_iλ^2/(λ^2-C_i)`   B_1, C_1, B_2, C_2, … (C in µm²)
    power-series :math:`n^2 = \sum_i a_i λ^{p_i}`            a_1, p_1, a_2, p_2, …
    ============ =========================================== ==============================

    where that of Abbe goes through :math:`n_d` at 587.56 nm with
    :math:`V_d = (n_d-1)/(n_F-n_C)`.

    Attributes
    ----------
    name
        Name in camera files: small letters and digits, in parts joined by hyphens.
    source
        Where the formula comes from; "placeholder" marks what no public figure is known for.
    formula
        One of the above.
    coefficients
        Its numbers, in the order above.
    range_nm
        Shortest and longest wavelength that the formula is used at. The index is 1 to 4 at all
        of them.
    density_g_cm3
        Density after curing at room temperature, in g/cm³.
    density_source
        Where it comes from.
    cure_shrinkage_percent
        Fraction of its volume that the poured liquid loses until it is cured and cold, in percent.
    cure_shrinkage_source
        Where it comes from.
    """

    name: Annotated[str, Field(max_length=40)]
    source: Text
    formula: Literal["constant", "abbe", "cauchy", "sellmeier", "power-series"]
    coefficients: tuple[Annotated[Number, Between(-1e9, 1e9)], ...] = Field(max_length=20)
    range_nm: tuple[Wavelength, Wavelength]
    density_g_cm3: Annotated[Number, Between(1e-4, 30)] | None = None
    density_source: Text | None = None
    cure_shrinkage_percent: Annotated[Number, Between(0, 90)] | None = None
    cure_shrinkage_source: Text | None = None

    @field_validator("name")
    @classmethod
    def _check_name(cls, name: str) -> str:
        parts = name.split("-")
        if not all(part.isascii() and part.isalnum() and part == part.lower() for part in parts):
            raise refusal(
                "it must be of small letters and digits, in parts joined by hyphens, such as "
                "my-resin"
            )
        return name

    @model_validator(mode="after")
    def _check_all(self) -> Self:
        if self.range_nm[0] >= self.range_nm[1]:
            raise refusal(
                f"range_nm goes from {self.range_nm[0]:g} to {self.range_nm[1]:g}: give the "
                "shorter wavelength first, such as [350, 1100]"
            )
        self._check_count()
        for what, source in (
            ("density_g_cm3", "density_source"),
            ("cure_shrinkage_percent", "cure_shrinkage_source"),
        ):
            if (getattr(self, what) is None) != (getattr(self, source) is None):
                raise refusal(f"{what} and {source} belong together: give both, or leave both out")
        self._check_values()
        return self

    def _check_count(self) -> None:
        count = len(self.coefficients)
        expected, right = {
            "constant": ("one, the index", count == 1),
            "abbe": ("two, the index at line d and the Abbe number", count == 2),
            "cauchy": ("one or more, A, B, C, …", count >= 1),
            "sellmeier": ("pairs, B and C of each term", count >= 2 and count % 2 == 0),
            "power-series": ("pairs, factor and power of each term", count >= 2 and count % 2 == 0),
        }[self.formula]
        if not right:
            raise refusal(
                f"the formula {self.formula} takes other coefficients than these {count}: give "
                f"{expected}"
            )
        if self.formula == "abbe" and self.coefficients[1] <= 0:
            raise refusal(
                f"the Abbe number is {self.coefficients[1]:g}: give one above zero, such as 50"
            )

    def _check_values(self) -> None:
        low, high = self.range_nm
        if self.formula == "sellmeier":
            for strength, squared in zip(
                self.coefficients[::2], self.coefficients[1::2], strict=True
            ):
                resonance = 1e3 * math.sqrt(max(squared, 0.0))
                if strength != 0 and low <= resonance <= high:
                    raise refusal(
                        f"the formula has a resonance at {resonance:g} nm, within range_nm: give "
                        "a range beside it, and C as the square of a wavelength in um"
                    )
        probes = np.geomspace(low, high, _PROBES)
        index = self._evaluated(probes)
        wrong = np.flatnonzero(~((index >= _LOWEST) & (index <= _HIGHEST)))
        if len(wrong):
            raise refusal(
                f"the refractive index is {index[wrong[0]]:.5g} at {probes[wrong[0]]:.4g} nm; it "
                "must be 1 to 4 within range_nm: check the coefficients (wavelengths in um), or "
                "give a smaller range"
            )

    def _evaluated(self, wavelength_nm: Array) -> Array:
        """Values of the formula; NaN where it has none."""
        c = self.coefficients
        squared = np.square(np.multiply(wavelength_nm, 1e-3))
        pairs = list(zip(c[::2], c[1::2], strict=False))
        with np.errstate(all="ignore"):
            if self.formula == "abbe":
                f, d, line_c = (_LINES_NM[line] ** -2 * 1e6 for line in "FdC")
                return c[0] + (c[0] - 1) / c[1] / (f - line_c) * (1 / squared - d)
            if self.formula == "sellmeier":
                return np.sqrt(1 + sum(b * squared / (squared - at) for b, at in pairs))
            if self.formula == "power-series":
                return np.sqrt(sum(factor * squared ** (power / 2) for factor, power in pairs))
            # A constant is Cauchy's formula with one coefficient.
            return sum((each / squared**power for power, each in enumerate(c)), np.zeros(()))

    def index(self, wavelength_nm: float) -> float:
        """Refractive index at a wavelength in vacuum.

        Raises
        ------
        OptionError
            If the wavelength is outside `range_nm`.
        """
        low, high = self.range_nm
        if not low <= wavelength_nm <= high:
            raise OptionError(
                f"the refractive index of {self.name} is known from {low:g} to {high:g} nm, not "
                f"at {wavelength_nm:g} nm: choose light in that range, or another material"
            )
        return float(self._evaluated(np.array(wavelength_nm, np.float64)))

    @property
    def index_d(self) -> float:
        """Refractive index at 587.56 nm (line d)."""
        return self.index(_LINES_NM["d"])

    @property
    def abbe(self) -> float | None:
        """Abbe number V_d = (n_d − 1) / (n_F − n_C); None without dispersion."""
        spread = self.index(_LINES_NM["F"]) - self.index(_LINES_NM["C"])
        return (self.index_d - 1) / spread if spread != 0 else None

    @property
    def cure_shrinkage(self) -> float | None:
        """Fraction of the poured volume that curing takes: 0.05 for 5 %."""
        return None if self.cure_shrinkage_percent is None else self.cure_shrinkage_percent / 100


def _built_in(name: str) -> Material:
    text = (files("nolens.camera") / "materials" / f"{name}.toml").read_text(encoding="utf-8")
    return Material.model_validate(tomllib.loads(text))


MATERIALS: dict[str, Material] = {name: _built_in(name) for name in _BUILT_IN}
"""All materials that come with the package, by name."""


def material(name: str, own: Mapping[str, Material] | None = None) -> Material:
    """Look a material up.

    Parameters
    ----------
    name
        Its name.
    own
        Materials that are known besides those of the package, by name.

    Raises
    ------
    OptionError
        If there is none of this name; with the nearest name and all of them.
    """
    known = {**(own or {}), **MATERIALS}
    if name not in known:
        raise OptionError(
            f"there is no material {name!r}{suggestion(name, known)} Known are "
            f"{', '.join(known)}; for another one give its index as a number, or "
            "describe it in TOML (nolens material show pua311 shows how)"
        )
    return known[name]


def check_own_name(own: Material) -> None:
    """Refuse a material that would hide another one of the package.

    Raises
    ------
    OptionError
        If one of this name comes with the package and is not the same.
    """
    if MATERIALS.get(own.name, own) != own:
        raise OptionError(
            f"a material {own.name!r} comes with nolens: give yours another name, such as "
            f"my-{own.name}"
        )


def material_figures(material: Material) -> dict[str, Any]:
    """Derive figures of a material, in values that JSON has.

    Returns
    -------
    dict
        Refractive indices at the Fraunhofer lines F, d and C and at some wavelengths in nm, as
        far as they are within its range; its Abbe number, null without dispersion or where a
        line is outside; what of its figures is a placeholder.
    """
    low, high = material.range_nm
    lines = {name: at for name, at in _LINES_NM.items() if low <= at <= high}
    sources = {
        "index": material.source,
        "density": material.density_source,
        "cure shrinkage": material.cure_shrinkage_source,
    }
    abbe = material.abbe if len(lines) == len(_LINES_NM) else None
    return {
        "index_at_lines": {name: round(material.index(at), _DIGITS) for name, at in lines.items()},
        "index_at_nm": {
            str(at): round(material.index(at), _DIGITS) for at in _TABLE_NM if low <= at <= high
        },
        "abbe": None if abbe is None else round(abbe, 3),
        "placeholders": [
            what for what, source in sources.items() if source and "placeholder" in source
        ],
    }
