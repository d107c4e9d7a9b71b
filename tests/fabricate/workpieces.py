"""Cameras, frames and reliefs for the tests of the workshop's files."""

from typing import Any

import numpy as np
import torch

from nolens.camera import Camera, Layer, from_mapping, preset
from nolens.fabricate import FrameGeometry, MadeSurface, Solid, made_surface
from nolens.optics import Relief

PAPER = preset("paper")


def frame(**changed: Any) -> FrameGeometry:
    given: dict[str, Any] = {
        "package_width_mm": 10.0, "package_height_mm": 8.0, "glass_top_mm": 2.0, "layer_mm": 1.0,
        "clearance_mm": 0.25, "wall_mm": 1.5, "rim_mm": 0.5, "vent_width_mm": 1.0,
        "vent_depth_mm": 0.25, "vents": 4, "mark_mm": 1.0,
    }  # fmt: skip
    return FrameGeometry(**{**given, **changed})


def with_layers(*layers: dict[str, Any], surface: int = 0) -> Camera:
    fields = PAPER.model_dump(mode="json")
    fields["layers"], fields["mask"]["surface"] = list(layers), surface
    return from_mapping(Camera, fields, "test")


def resin_of(thickness: str, **other: Any) -> Camera:
    layers = (Layer(name="resin", thickness=thickness, **other), *PAPER.layers[1:])
    return PAPER.model_copy(update={"layers": layers})


def inside(solid: Solid, points: list[list[float]]) -> list[bool]:
    """Whether points lie in a solid, by the solid angle that its surface fills around each."""
    found = []
    for point in points:
        a, b, c = (solid.vertices_mm[solid.triangles[:, corner]] - point for corner in range(3))
        la, lb, lc = (np.linalg.norm(each, axis=1) for each in (a, b, c))
        volume = np.einsum("ij,ij->i", a, np.cross(b, c))
        under = la * lb * lc + (a * b).sum(1) * lc + (a * c).sum(1) * lb + (b * c).sum(1) * la
        turns = np.arctan2(volume, under).sum() / (2 * np.pi)
        assert abs(turns - round(turns)) < 1e-6
        found.append(round(turns) == 1)
    return found


def lopsided(rows: int = 7, columns: int = 11, grid_um: float = 2.0) -> Relief:
    """Heights that no turn or flip leaves alone."""
    row, column = torch.meshgrid(
        torch.arange(rows, dtype=torch.float32), torch.arange(columns, dtype=torch.float32),
        indexing="ij",
    )  # fmt: skip
    return Relief(0.3 * row + 0.05 * column**1.5 + 0.1 * torch.sin(row * column), grid_um)


def smooth(rows: int, columns: int, seed: int, grid_um: float = 1.5) -> Relief:
    """A few waves in random directions."""
    generator = torch.Generator().manual_seed(seed)
    y, x = torch.meshgrid(
        torch.arange(rows) * grid_um, torch.arange(columns) * grid_um, indexing="ij"
    )
    height = torch.zeros(rows, columns)
    for _ in range(5):
        turns, phase = torch.randn(2, generator=generator) / 40, torch.rand(1, generator=generator)
        height += torch.sin(6.2832 * (turns[0] * y + turns[1] * x + phase))
    return Relief(0.4 * height, grid_um)


def surface(relief: Relief, name: Any = "master", **more: Any) -> MadeSurface:
    return made_surface(relief, name, "test", **more)
