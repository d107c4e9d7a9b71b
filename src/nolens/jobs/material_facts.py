"""What follows from a material's description, in figures."""

from typing import Any

from nolens.camera import LINES_NM, Material

_WAVELENGTHS_NM = (400, 450, 500, 535, 550, 600, 620, 650, 700, 850)
_DIGITS = 6


def material_facts(material: Material) -> dict[str, Any]:
    """Derive figures of a material, in values that JSON has.

    Parameters
    ----------
    material
        The material.

    Returns
    -------
    dict
        Refractive indices at the Fraunhofer lines F, d and C and at some wavelengths in nm, as
        far as they are within its range; its Abbe number, null without dispersion or where a
        line is outside; what of its figures is a placeholder.
    """
    low, high = material.range_nm
    lines = {name: at for name, at in LINES_NM.items() if low <= at <= high}
    sources = {
        "index": material.source,
        "density": material.density_source,
        "cure shrinkage": material.cure_shrinkage_source,
    }
    abbe = material.abbe if len(lines) == len(LINES_NM) else None
    return {
        "index_at_lines": {name: round(material.index(at), _DIGITS) for name, at in lines.items()},
        "index_at_nm": {
            str(at): round(material.index(at), _DIGITS)
            for at in _WAVELENGTHS_NM
            if low <= at <= high
        },
        "abbe": None if abbe is None else round(abbe, 3),
        "placeholders": [
            what for what, source in sources.items() if source and "placeholder" in source
        ],
    }
