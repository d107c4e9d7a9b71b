"""What the tests of the twin share: crops of the presets that two cores carry, and measures."""

import math
from typing import Any

import torch
from torch import Tensor

from nolens.camera import Camera, Flat, LoadedCamera, SpectralCurve, preset
from nolens.optics import PointSource
from nolens.quantities import Length
from nolens.twin import Light, Twin

WHITE = Light("white-led")
GREEN = Light("550nm")
GREEN_NM = 550.0

Pair = tuple[float, float]


def cropped(
    rows: int, columns: int, *, of: str = "paper", pitch: str = "1.55 um", **relief: Any
) -> Camera:
    """A preset with some of its pixels, and with changes of its relief; lengths are text."""
    camera = preset(of)
    sensor = camera.sensor.model_copy(
        update={"rows": rows, "columns": columns, "pitch": Length.parse(pitch)}
    )
    read = {key: Length.parse(v) if isinstance(v, str) else v for key, v in relief.items()}
    changed = camera.mask.relief.model_copy(update=read)
    mask = camera.mask.model_copy(update={"relief": changed})
    return camera.model_copy(update={"sensor": sensor, "mask": mask})


def in_grey(camera: Camera) -> Camera:
    """The camera without its mosaic: a third of the work."""
    curve = camera.sensor.quantum_efficiency
    assert isinstance(curve, SpectralCurve)
    mean = tuple(sum(values) / 3 for values in zip(*curve.values.values(), strict=True))
    one = SpectralCurve(
        source="mean of three", wavelength_nm=curve.wavelength_nm, values={"grey": mean}
    )
    sensor = camera.sensor.model_copy(update={"mosaic": "none", "quantum_efficiency": one})
    return camera.model_copy(update={"sensor": sensor})


def flattened(camera: Camera) -> Camera:
    """The camera with a flat surface and no aperture."""
    mask = camera.mask.model_copy(update={"relief": Flat(kind="flat"), "aperture": None})
    return camera.model_copy(update={"mask": mask})


def twin_of(camera: Camera, *, fresnel: bool = False) -> Twin:
    return Twin.of(LoadedCamera.of(camera), fresnel=fresnel)


def toward(
    angle_deg: float, azimuth_deg: float = 0.0, distance_um: float = math.inf
) -> PointSource:
    """A point source; the azimuth turns from the columns (right) to the rows (down)."""
    tangent, azimuth = math.tan(math.radians(angle_deg)), math.radians(azimuth_deg)
    return PointSource((tangent * math.sin(azimuth), tangent * math.cos(azimuth)), distance_um)


def snell_um(camera: Camera, angle_deg: float, wavelength_nm: float = GREEN_NM) -> float:
    """How far the layers move a ray sideways: thickness times tangent, layer by layer."""
    sine = math.sin(math.radians(angle_deg))
    return sum(
        layer.thickness.um * math.tan(math.asin(sine / index))
        for layer, index in zip(camera.layers, camera.indices(wavelength_nm), strict=True)
    )


def reduced_um(camera: Camera, wavelength_nm: float = GREEN_NM) -> float:
    """Σ thickness / index."""
    indices = camera.indices(wavelength_nm)
    return sum(
        layer.thickness.um / index for layer, index in zip(camera.layers, indices, strict=True)
    )


def offset(picture: Tensor, template: Tensor) -> Pair:
    """Cells by which a picture is moved against a template of its size, to a part of a cell."""
    size = template.shape
    spectra = [
        torch.fft.rfft2(each.double() - each.double().mean()) for each in (picture, template)
    ]
    correlation = torch.fft.irfft2(spectra[0] * spectra[1].conj(), s=size)
    row, column = divmod(int(correlation.argmax()), size[1])
    lines = (row, correlation[:, column]), (column, correlation[row])
    moved = []
    for at, line in lines:
        before, top, after = (float(line[(at + step) % len(line)]) for step in (-1, 0, 1))
        whole = at - len(line) if at > len(line) // 2 else at
        moved.append(whole + (before - after) / (2 * (before - 2 * top + after)))
    return moved[0], moved[1]


def relative_error(got: Tensor, expected: Tensor) -> float:
    """Norm of the difference over the norm of what was expected."""
    got, expected = got.double(), expected.double()
    return float((got - expected).norm() / expected.norm())
