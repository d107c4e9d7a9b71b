"""`nolens material`."""

import json
from typing import Annotated, Any

from cyclopts import App, Parameter

from nolens.camera import MATERIALS, Material, to_toml
from nolens.camera.materials import material_figures
from nolens.cli.command import Json
from nolens.cli.messages import say, show
from nolens.files import read_material

material = App(name="material", help="Materials that layers of a camera are made of.")

_FORMULAS = {
    "constant": "n = n0 at all wavelengths",
    "abbe": "n = A + B/λ², through n_d with the Abbe number V_d",
    "cauchy": "n = A + B/λ² + C/λ⁴ + …, λ in um",
    "sellmeier": "n² = 1 + Σ B λ²/(λ² − C), λ in um, coefficients B, C of each term",
    "power-series": "n² = Σ a λ^p, λ in um, coefficients a, p of each term",
}


_JSON = "Print one JSON object on standard output:"
_All = Annotated[Json, Parameter(help=f"{_JSON} all materials and what follows from each.")]
_One = Annotated[Json, Parameter(help=f"{_JSON} the description and what follows from it.")]


@material.command(name="list")
def list_materials(*, json_: _All = False) -> int:
    """List the materials that come with nolens.

    nolens material list
    """
    if json_:
        show(json.dumps({"materials": [_described(each) for each in MATERIALS.values()]}))
        return 0
    show(f"{'name':14} {'n_d':>7} {'V_d':>5}  {'g/cm³':>5}  source")
    for each in MATERIALS.values():
        facts = material_figures(each)
        abbe = "" if facts["abbe"] is None else f"{facts['abbe']:.1f}"
        density = "" if each.density_g_cm3 is None else f"{each.density_g_cm3:g}"
        show(f"{each.name:14} {each.index_d:7.4f} {abbe:>5}  {density:>5}  {each.source}")
    return 0


@material.command(name="show")
def show_material(name: str, /, *, json_: _One = False) -> int:
    """Print a material as TOML, and on standard error what follows from it.

    nolens material show noa61 > my-resin.toml

    Give the copy a name of its own and other figures; it can be named wherever a material is
    (--material my-resin.toml), or stand in a camera.toml under [[materials]].

    Parameters
    ----------
    name
        One of the names of nolens material list, or a .toml file.
    """
    material = read_material(name)
    if json_:
        show(json.dumps(_described(material)))
        return 0
    for line in to_toml(material).removesuffix("\n").split("\n"):
        show(line)
    for line in _lines(material, material_figures(material)):
        say(line)
    return 0


def _described(material: Material) -> dict[str, Any]:
    return {"material": material.model_dump(mode="json"), **material_figures(material)}


def _lines(material: Material, facts: dict[str, Any]) -> list[str]:
    lines = facts["index_at_lines"]
    at_lines = ", ".join(f"n_{line} {index:.5f}" for line, index in lines.items())
    by_wavelength = ", ".join(f"{at} nm {n:.4f}" for at, n in facts["index_at_nm"].items())
    texts = [_FORMULAS[material.formula]]
    if at_lines:
        abbe = "no dispersion" if facts["abbe"] is None else f"V_d {facts['abbe']:.2f}"
        texts.append(f"{at_lines}, {abbe}" if len(lines) == 3 else at_lines)
    if by_wavelength:
        texts.append(by_wavelength)
    if material.cure_shrinkage_percent is not None:
        texts.append(
            f"curing takes {material.cure_shrinkage_percent:g} % of the volume: fill "
            f"{1 / (1 - material.cure_shrinkage_percent / 100):.3f} times what is to remain"
        )
    if facts["placeholders"]:
        texts.append(f"placeholders, not measured: {', '.join(facts['placeholders'])}")
    return texts
