"""What of a camera can come out differently, within what limits, and by how much it may."""

import difflib
import math
import re
from dataclasses import dataclass

from nolens.amounts import amount
from nolens.camera import Camera, Flat
from nolens.design.tolerances.distributions import Parameter
from nolens.errors import OptionError
from nolens.twin import REFERENCE_NM

_AIR_BELOW = 1.05
_SCALE_LIMIT = 10.0
_WEDGE_LIMIT_DEG = 10.0
_NUMBERED = re.compile(r"layers\.(\d+)(\..+)?")


@dataclass(frozen=True)
class Variable:
    """A quantity of a camera that can vary.

    Parameters
    ----------
    name
        In tolerance files.
    unit
        As in `Parameter`.
    middle
        What the camera's description says.
    lowest, highest
        Between these, ends included, it is possible.
    usual
        ± that is assumed where nobody gives one, with its middle; None: it does not vary.
    note
        Why that is assumed.
    """

    name: str
    unit: str
    middle: float
    lowest: float
    highest: float
    usual: tuple[float, float] | None
    note: str

    @property
    def accepted(self) -> str:
        """What values are possible, for messages."""
        if self.lowest == math.nextafter(0, 1):
            return f"it must be more than 0 {self.unit}"
        return f"it must be {self.lowest:g} to {amount(self.highest, self.unit, digits=6)}"


def variables(camera: Camera) -> dict[str, Variable]:
    """All quantities of a camera that can vary, by name.

    Thickness and index (at 550 nm) of every layer; wedge of the mask's layer, of which
    the sensor's longer side sees thicker and thinner parts; relief.gain, a factor on its heights;
    relief.shrinkage, which makes the relief smaller in all directions and its layer thinner;
    decentre of the mask along the sensor's rows, in which the wedge rises.

    Raises
    ------
    OptionError
        If the camera's mask is flat, so that it has no PSF.
    """
    if isinstance(camera.mask.relief, Flat):
        raise OptionError(
            f"the mask of {camera.name!r} is flat, so it casts no PSF that could be sharp: "
            "give a camera whose relief is random-lenslets or a file"
        )
    found = []
    for number, name in enumerate(layer_names(camera)):
        found += _of_layer(camera, number, name)
    layer = camera.layers[camera.mask.surface]
    steepest = math.degrees(math.atan(0.2 * layer.thickness.um / lit_width_um(camera)))
    positive = math.nextafter(0, 1)
    sensor_um = camera.sensor.columns * camera.sensor.pitch.um
    found += [
        Variable(
            "wedge",
            "deg",
            0.0,
            -_WEDGE_LIMIT_DEG,
            _WEDGE_LIMIT_DEG,
            (0.0, _rounded(min(0.5, steepest))),
            "assumed: the mould lies on a printed frame",
        ),
        Variable(
            "relief.gain",
            "%",
            100.0,
            positive,
            200.0,
            (100.0, 5.0),
            "assumed: depth of the mould's copy",
        ),
        Variable(
            "relief.shrinkage",
            "%",
            0.0,
            -_SCALE_LIMIT,
            _SCALE_LIMIT,
            (2.0, 1.0),
            "assumed: shrinkage of a resin as it cures",
        ),
        Variable(
            "decentre",
            "um",
            0.0,
            -sensor_um / 2,
            sensor_um / 2,
            (0.0, _rounded(min(100.0, sensor_um / 8))),
            "assumed: laid on by hand",
        ),
    ]
    return {each.name: each for each in found}


def find(known: dict[str, Variable], camera: Camera, name: str) -> Variable:
    """Look a quantity up, also by the number of its layer, as in ``layers.0.thickness``.

    Raises
    ------
    OptionError
        If there is none of this name; with the nearest one and all of them.
    """
    numbered = _NUMBERED.fullmatch(name)
    if numbered is not None and numbered[2] and int(numbered[1][:3]) < len(camera.layers):
        name = layer_names(camera)[int(numbered[1][:3])] + numbered[2]
    if name in known:
        return known[name]
    near = difflib.get_close_matches(name.lower(), known, n=1)
    raise OptionError(
        f"the camera {camera.name!r} has no parameter {name!r}"
        + (f"; did you mean {near[0]!r}?" if near else ";")
        + f" Known are {', '.join(known)}"
    )


def default_parameters(camera: Camera) -> tuple[Parameter, ...]:
    """Assumptions for a camera of which nobody has measured how well it can be made.

    Normal distributions whose tolerance is 2 σ: the mask's layer ± 50 um and all others ± 20 um
    (a tenth of a thin layer), indices ± 0.005, wedge ± 0.5 deg, heights ± 5 %, shrinkage 2 ± 1 %,
    decentre ± 100 um.

    Raises
    ------
    OptionError
        If the camera's mask is flat.
    """
    found = []
    for each in variables(camera).values():
        if each.usual is not None:
            middle, tolerance = each.usual
            found.append(
                Parameter(each.name, "normal", middle, tolerance, each.unit, note=each.note)
            )
    return tuple(found)


def layer_names(camera: Camera) -> tuple[str, ...]:
    """Names of layers: their own where nothing else has them, else ``layers.`` and the number."""
    own = [layer.name or "" for layer in camera.layers]
    return tuple(
        name
        if own.count(name) == 1 and name and name != "relief" and not _NUMBERED.fullmatch(name)
        else f"layers.{number}"
        for number, name in enumerate(own)
    )


def lit_width_um(camera: Camera) -> float:
    """Length along the sensor's rows over which its PSF reaches."""
    width = camera.sensor.columns * camera.sensor.pitch.um
    aperture = camera.mask.aperture
    return width if aperture is None else min(width, aperture.width.um)


def _of_layer(camera: Camera, number: int, name: str) -> list[Variable]:
    layer = camera.layers[number]
    thickness, index = layer.thickness.um, camera.indices(REFERENCE_NM)[number]
    moulded = number == camera.mask.surface
    usual = _rounded(min(50.0 if moulded else 20.0, thickness / 10))
    note = "a printed frame" if moulded else "the part's usual spread"
    air = index < _AIR_BELOW
    return [
        Variable(
            f"{name}.thickness",
            "um",
            thickness,
            math.nextafter(0, 1),
            math.inf,
            (thickness, usual),
            f"assumed: {note}",
        ),
        Variable(
            f"{name}.index",
            "",
            index,
            1.0,
            4.0,
            None if air else (index, 0.005),
            "" if air else "assumed: from batch to batch",
        ),
    ]


def _rounded(value: float) -> float:
    return float(f"{value:.2g}")
