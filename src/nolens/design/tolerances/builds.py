"""Cameras as they come out: what their parameters mean for layers and relief."""

import math
from dataclasses import dataclass, replace

import torch
from torch import Tensor

from nolens.amounts import amount
from nolens.camera import Camera
from nolens.design.tolerances.distributions import Parameter
from nolens.design.tolerances.variables import Variable, layer_names, lit_width_um, variables
from nolens.errors import OptionError


@dataclass(frozen=True)
class Builds:
    """Some cameras that came out differently, float64.

    Parameters
    ----------
    thickness_um
        (cameras, layers), at the mask's middle; shrinkage is included.
    index_change
        (cameras, layers), the same at all wavelengths.
    wedge
        (cameras,), slope of the mask's layer along the sensor's rows.
    gain
        (cameras,), factor on the relief's heights, without shrinkage.
    scale
        (cameras,), factor on the relief in all three directions: 1 − shrinkage.
    decentre_um
        (cameras,), how far the mask lies to the side of larger columns.
    """

    thickness_um: Tensor
    index_change: Tensor
    wedge: Tensor
    gain: Tensor
    scale: Tensor
    decentre_um: Tensor

    @classmethod
    def of(cls, camera: Camera, names: tuple[str, ...], rows: Tensor) -> "Builds":
        """Make cameras of their parameters.

        Parameters
        ----------
        camera
            The description; what is not in `names` is as it says.
        names
            Of the parameters, as in `variables`.
        rows
            (cameras, parameters), in the units of `variables`.
        """
        columns = {
            name: rows[:, names.index(name)]
            if name in names
            else torch.full((len(rows),), each.middle, dtype=torch.float64)
            for name, each in variables(camera).items()
        }
        known, layers = variables(camera), layer_names(camera)
        scale = 1 - columns["relief.shrinkage"] / 100
        thickness = torch.stack([columns[f"{each}.thickness"] for each in layers], dim=1)
        thickness[:, camera.mask.surface] *= scale
        index = [columns[f"{each}.index"] - known[f"{each}.index"].middle for each in layers]
        return cls(
            thickness,
            torch.stack(index, dim=1),
            torch.tan(torch.deg2rad(columns["wedge"])),
            columns["relief.gain"] / 100,
            scale,
            columns["decentre"],
        )

    def __len__(self) -> int:
        return len(self.wedge)

    def at(self, camera: Camera, place_um: float) -> "Builds":
        """The same cameras as they are at a place on the sensor, along its rows from the middle."""
        thickness = self.thickness_um.clone()
        thickness[:, camera.mask.surface] += self.wedge * (place_um - self.decentre_um)
        return replace(self, thickness_um=thickness)


def check_possible(camera: Camera, parameters: tuple[Parameter, ...], rows: Tensor) -> None:
    """Refuse cameras that cannot exist, before one is computed.

    Parameters
    ----------
    camera
        The description.
    parameters
        What varies.
    rows
        (cameras, parameters), drawn from them.

    Raises
    ------
    OptionError
        If a thickness, an index or another parameter is impossible, at its tolerance or in one of
        the cameras; says the largest tolerance that would do.
    """
    known = variables(camera)
    for number, each in enumerate(parameters):
        allowed = known[each.name]
        drawn = rows[:, number]
        ends = torch.tensor([each.middle - each.tolerance, each.middle + each.tolerance])
        values = torch.cat([drawn, ends.double()])
        low, high = float(values.min()), float(values.max())
        if low < allowed.lowest or high > allowed.highest:
            wrong = low if low < allowed.lowest else high
            largest = _floor(largest_possible(allowed, each, rows[:, number]))
            advice = (
                f"with these trials ± {amount(largest, each.unit, digits=6)}"
                + " is the largest that "
                "would do, or cut the distribution with at_most"
                if largest > 0
                else f"change its mean, {amount(each.middle, each.unit, digits=6)}"
            )
            raise OptionError(
                f"{each.name} = {amount(wrong, each.unit, digits=4)}"
                + f" comes out of a tolerance of {amount(each.tolerance, each.unit, digits=6)}"
                + f", and {allowed.accepted}: {advice}"
            )
    if not leaves_thickness(camera, parameters, rows):
        raise OptionError(
            "the wedge leaves no thickness of the mask's layer at one end of the sensor: give a "
            "smaller tolerance of wedge, or of the layer's thickness"
        )


def leaves_thickness(camera: Camera, parameters: tuple[Parameter, ...], rows: Tensor) -> bool:
    """Whether the mask's layer has a thickness wherever light passes it, in all cameras."""
    names = tuple(each.name for each in parameters)
    builds = Builds.of(camera, names, rows)
    half = lit_width_um(camera) / 2
    ends = [
        builds.at(camera, place).thickness_um[:, camera.mask.surface] for place in (-half, half)
    ]
    return bool((torch.stack(ends) > 0).all())


def largest_possible(allowed: Variable, parameter: Parameter, drawn: Tensor) -> float:
    """Tolerance at which the first of some trials becomes impossible; 0 if the middle is so.

    Parameters
    ----------
    allowed
        Says what is possible.
    parameter
        With what it was drawn.
    drawn
        Its values.
    """
    away = (drawn - parameter.middle) / (parameter.tolerance or 1.0)
    down, up = max(1.0, -float(away.min())), max(1.0, float(away.max()))
    room = (parameter.middle - allowed.lowest) / down, (allowed.highest - parameter.middle) / up
    return max(0.0, min(room))


def _floor(value: float) -> float:
    """Two digits, rounded down."""
    if value <= 0:
        return 0.0
    step = 10.0 ** (math.floor(math.log10(value)) - 1)
    return math.floor(value / step * (1 + 1e-12)) * step
