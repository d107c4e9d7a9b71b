"""Transparent materials that layers of a camera are made of."""

import difflib
from dataclasses import dataclass

from nolens.errors import OptionError

_D_NM, _F_NM, _C_NM = 587.56, 486.13, 656.27


@dataclass(frozen=True)
class Material:
    """A transparent material.

    Attributes
    ----------
    name
        Name in camera files.
    index_d
        Refractive index at 587.56 nm (line d).
    abbe
        Abbe number V_d = (n_d − 1) / (n_F − n_C); None where the index is the same at all
        wavelengths.
    source
        Where the figures come from; "placeholder" marks what no public figure is known for.
    """

    name: str
    index_d: float
    abbe: float | None
    source: str

    def index(self, wavelength_nm: float) -> float:
        """Refractive index, by n = A + B/λ² through the index at line d and the Abbe number.

        Parameters
        ----------
        wavelength_nm
            Wavelength in vacuum, in nm. The formula is meant for visible light.
        """
        if self.abbe is None:
            return self.index_d
        b = (self.index_d - 1) / self.abbe / (_F_NM**-2 - _C_NM**-2)
        return self.index_d + b * (wavelength_nm**-2 - _D_NM**-2)


_TABLE = (
    Material("air", 1.0, None, "by definition; its dispersion is neglected"),
    Material(
        "pua311",
        1.47,
        50.0,
        "index: the paper's figure for its polyurethane acrylate resin; "
        "placeholder for the Abbe number",
    ),
    Material(
        "pdms",
        1.43,
        44.4,
        "index: the paper's figure; placeholder for the Abbe number, near what is published for "
        "Sylgard 184",
    ),
    Material(
        "polycarbonate",
        1.59,
        29.1,
        "index: the paper's figure; Abbe number: Sultanova et al. 2009 (sultanova2009)",
    ),
    Material(
        "cover-glass",
        1.52,
        55.0,
        "index: the paper's figure; placeholder for the Abbe number, near that of borosilicate "
        "cover glasses",
    ),
    Material("fused-silica", 1.4585, 67.8, "tables of optical glass"),
    Material("pmma", 1.491, 59.2, "Sultanova et al. 2009 (sultanova2009)"),
    Material("bk7", 1.5168, 64.17, "Schott N-BK7"),
)

MATERIALS: dict[str, Material] = {each.name: each for each in _TABLE}
"""All materials that are known, by name."""


def material(name: str) -> Material:
    """Look a material up.

    Raises
    ------
    OptionError
        If there is none of this name; with the nearest name and all of them.
    """
    if name not in MATERIALS:
        near = difflib.get_close_matches(name.lower(), MATERIALS, n=1)
        raise OptionError(
            f"there is no material {name!r}"
            + (f"; did you mean {near[0]!r}?" if near else ";")
            + f" Known are {', '.join(MATERIALS)}; for another one give its index as a number"
        )
    return MATERIALS[name]
