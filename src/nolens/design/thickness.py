"""How thick the resin of a replica must be on a sensor, with the ± of everything."""

import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass, replace
from functools import cached_property
from typing import Any, Literal

import torch
from torch import Tensor

from nolens.camera import MATERIALS, Camera, Layer, LoadedCamera, Mask, Material, RandomLenslets
from nolens.design.replica import (
    SHARP_LINE_RATIO,
    Cover,
    Film,
    Replica,
    printed_radius_um,
    replica_thickness_um,
)
from nolens.design.uncertain import Propagated, Uncertain, propagate
from nolens.errors import OptionError
from nolens.optics import Number
from nolens.quantities import Length

_AIR = 1.0
_COLOURS_NM = (450.0, 500.0, 550.0, 600.0, 650.0)
_CURVES_NM = (450.0, 550.0, 650.0)
_CURVE_POINTS = 201
_UM_TO_MM = 1e-3
_UNITS = {"line_width": ("_um", 1.0), "aperture": ("", 1.0)}
"""Of the figures that are not lengths in mm: the end of their name, and one um in them."""

Values = Mapping[str, Number]


@dataclass(frozen=True)
class Medium:
    """What a layer is made of.

    Parameters
    ----------
    name
        For words.
    material
        None where the index is given as a number.
    index
        That number.
    """

    name: str
    material: Material | None
    index: Uncertain | None = None

    @classmethod
    def of_material(cls, material: Material) -> "Medium":
        """One whose index is known at all wavelengths of its range."""
        return cls(material.name, material)

    @classmethod
    def of_index(cls, index: Uncertain) -> "Medium":
        """One of which a person knows nothing but the index."""
        return cls(f"n {index.value:g}", None, index)

    def at(self, wavelength_nm: float) -> Uncertain:
        """Refractive index at a wavelength."""
        if self.material is not None:
            return Uncertain(self.material.index(wavelength_nm))
        assert self.index is not None
        return self.index

    def covers(self, wavelength_nm: float) -> bool:
        """Whether the index is known at a wavelength."""
        if self.material is None:
            return True
        low, high = self.material.range_nm
        return low <= wavelength_nm <= high

    @property
    def is_air(self) -> bool:
        """Whether light passes it as it passes air."""
        shortest_nm = 0.0 if self.material is None else self.material.range_nm[0]
        return self.at(shortest_nm).value == _AIR

    def layer(self, name: str | None, thickness_um: float) -> Layer:
        """A layer of it."""
        thickness = Length.of(round(thickness_um * _UM_TO_MM, 9), "mm")
        if self.material is not None:
            return Layer(name=name, thickness=thickness, material=self.material.name)
        return Layer(name=name, thickness=thickness, index=self.at(0.0).value)


@dataclass(frozen=True)
class _CoverLayer:
    """One of the layers over the sensor."""

    name: str
    thickness: Uncertain
    medium: Medium

    def summary(self, wavelength_nm: float) -> dict[str, Any]:
        """What it is, in values that JSON has."""
        return {
            "name": self.name,
            "material": self.medium.name,
            "index": self.medium.at(wavelength_nm).value,
            "thickness_mm": self.thickness.summary(_UM_TO_MM),
        }


@dataclass(frozen=True)
class Master:
    """A film whose relief is copied.

    Parameters
    ----------
    medium, thickness
        Of the film.
    distance
        From the film to the cover of the sensor, where its PSF is sharpest.
    side
        Where its relief faces when that is measured.
    assumed
        Whether this is the paper's, as a person says nothing of theirs.
    """

    medium: Medium
    thickness: Uncertain
    distance: Uncertain
    side: Literal["scene", "sensor"] = "scene"
    assumed: bool = False

    def summary(self, wavelength_nm: float) -> dict[str, Any]:
        """What it is, in values that JSON has."""
        return {
            "material": self.medium.name,
            "index": self.medium.at(wavelength_nm).value,
            "thickness_mm": self.thickness.summary(_UM_TO_MM),
            "distance_mm": self.distance.summary(_UM_TO_MM),
            "side": self.side,
            "assumed": self.assumed,
        }


@dataclass(frozen=True)
class ThicknessCase:
    """A sensor with its cover, and the master that is copied onto it.

    Parameters
    ----------
    loaded
        The camera.
    cover
        What lies over its sensor, from the scene.
    master
        The master, or its radius of curvature where that is known.
    pitch
        Of the lenslets.
    rounding
        Of their valleys, over the pitch.
    wavelength
        Of the light that is to be in focus.
    source_um
        Distance of the point source.

    Raises
    ------
    OptionError
        If the master has the index of air, or lies on the sensor with its relief.
    """

    loaded: LoadedCamera
    cover: tuple[_CoverLayer, ...]
    master: Master | Uncertain
    pitch: Uncertain
    rounding: float
    wavelength: Length
    source_um: float

    def __post_init__(self) -> None:
        if isinstance(self.master, Uncertain):
            return
        index = self.master.medium.at(self.wavelength.nm).value
        if index <= _AIR:
            raise OptionError(
                f"the film's index of {index:g} is that of air, so its relief bends no light: give "
                "a higher one"
            )
        behind = self.master.distance.value + sum(layer.thickness.value for layer in self.cover)
        if self.master.side == "sensor" and behind <= 0:
            raise OptionError(
                "the film's relief lies on the sensor itself, where it cannot be sharpest: give "
                "the --film-distance at which its pattern is"
            )

    @property
    def printed_radius_um(self) -> float | None:
        """Radius by the paper's eq. 3 as printed, where that is about a camera like this."""
        master, names = self.master, tuple(layer.name for layer in self.cover)
        if isinstance(master, Uncertain) or names != ("glass", "gap") or master.side != "scene":
            return None
        if not math.isinf(self.source_um):
            return None
        glass, gap = (layer.thickness.value for layer in self.cover)
        index = master.medium.at(self.wavelength.nm).value
        radius_um = printed_radius_um(
            master.thickness.value, index, master.distance.value, glass, gap
        )
        return float(radius_um)

    def inputs(self, wavelength_nm: float, medium: Medium) -> dict[str, Uncertain]:
        """Every quantity that the figures of a replica follow from, by name; lengths in um."""
        inputs: dict[str, Uncertain] = {}
        if isinstance(self.master, Uncertain):
            inputs["radius"] = self.master
        else:
            inputs["film"] = self.master.thickness
            inputs["film index"] = self.master.medium.at(wavelength_nm)
            inputs["film distance"] = self.master.distance
        for layer in self.cover:
            inputs[layer.name] = layer.thickness
            inputs[f"{layer.name} index"] = layer.medium.at(wavelength_nm)
        return inputs | {"replica index": medium.at(wavelength_nm), "pitch": self.pitch}

    def replica_of(self, values: Values) -> Replica:
        """The replica, of such quantities as `inputs` names."""
        names = [layer.name for layer in self.cover]
        cover = Cover(
            tuple(values[name] for name in names),
            tuple(values[f"{name} index"] for name in names),
        )
        if isinstance(self.master, Uncertain):
            radius = values["radius"]
        else:
            film = Film(
                values["film"], values["film index"], values["film distance"], self.master.side
            )
            radius = film.over(cover, 1.0, self.source_um).focused_radius_um()
        return Replica(values["replica index"], radius, cover, self.source_um)


@dataclass(frozen=True)
class _ColourFocus:
    """Thickness in focus in some light, and how wide lines in it are at the one that is poured."""

    light: str
    wavelength_nm: float
    thickness_mm: float
    line_width_um: float


@dataclass(frozen=True)
class ColourCurves:
    """What a plot shows of one replica.

    Parameters
    ----------
    name
        Of the material.
    thickness_mm, plus_minus_mm
        Thickness in focus, and its ±.
    sharp_mm
        From which thickness to which the lines are at most 10 % wider than in focus.
    focus
        Pairs of wavelength in nm and thickness in focus in mm.
    thicknesses_mm
        Where the widths are given.
    widths_um
        By wavelength in nm, one width for each of those thicknesses.
    """

    name: str
    thickness_mm: float
    plus_minus_mm: float
    sharp_mm: tuple[float, float]
    focus: tuple[tuple[float, float], ...]
    thicknesses_mm: tuple[float, ...]
    widths_um: dict[float, tuple[float, ...]]


@dataclass(frozen=True)
class ReplicaDesign:
    """A replica of one material, as thick as it must be.

    Parameters
    ----------
    case
        What it is for.
    medium
        Of the replica.
    radius
        Of its lenslets, in um.
    figures
        With their ±, in um; see `nolens.design.replica.Replica.figures`.
    """

    case: ThicknessCase
    medium: Medium
    radius: Propagated
    figures: dict[str, Propagated]

    @classmethod
    def of(cls, case: ThicknessCase, medium: Medium) -> "ReplicaDesign":
        """Find the thickness that brings the point source to focus.

        Raises
        ------
        OptionError
            If the material cannot focus on this sensor.
        """
        wavelength_nm = case.wavelength.nm
        inputs = case.inputs(wavelength_nm, medium)
        nominal = {name: _scalar(each.value) for name, each in inputs.items()}
        case.replica_of(nominal).check(medium.name, wavelength_nm)

        def results(values: Mapping[str, Tensor]) -> dict[str, Tensor]:
            replica = case.replica_of(values)
            radius = torch.as_tensor(replica.radius_um, dtype=torch.float64)
            figures = replica.figures(wavelength_nm * 1e-3, values["pitch"], case.rounding)
            return {"radius": radius, **figures}

        figures = propagate(inputs, results)
        return cls(case, medium, figures.pop("radius"), figures)

    @property
    def sharp_um(self) -> tuple[float, float]:
        """Thicknesses between which the lines are at most 10 % wider than in focus."""
        thickness, room = self.figures["thickness"].value, self.figures["room"].value
        return max(0.0, thickness - room), thickness + room

    @property
    def printed_thickness_um(self) -> float | None:
        """Thickness by eq. 5 from the radius by eq. 3 as printed, where there is that."""
        radius_um = self.case.printed_radius_um
        if radius_um is None:
            return None
        wavelength_nm = self.case.wavelength.nm
        glass, gap = self.case.cover
        thickness_um = replica_thickness_um(
            radius_um,
            self.medium.at(wavelength_nm).value,
            glass.thickness.value,
            glass.medium.at(wavelength_nm).value,
            gap.thickness.value,
        )
        return float(thickness_um)

    @cached_property
    def colours(self) -> tuple[_ColourFocus, ...]:
        """Focus by wavelength: of some, and of the mean one of each channel of the sensor."""
        lights = {f"{each:g} nm": each for each in _COLOURS_NM}
        efficiency = self.case.loaded.quantum_efficiency
        for channel, values in efficiency.values.items():
            total = sum(values)
            if total > 0:
                pairs = zip(efficiency.wavelength_nm, values, strict=True)
                lights[channel] = sum(nm * value for nm, value in pairs) / total
        rows = []
        for name, nm in lights.items():
            if self._covers(nm):
                thickness, width = self._at(nm, self.figures["thickness"].value)
                rows.append(_ColourFocus(name, nm, thickness * _UM_TO_MM, float(width)))
        return tuple(rows)

    def curves(self) -> ColourCurves:
        """Compute what a plot shows."""
        poured = self.figures["thickness"]
        half = max(2.5 * self.figures["room"].value, 1.2 * poured.plus_minus)
        thicknesses = torch.linspace(
            max(0.0, poured.value - half), poured.value + half, _CURVE_POINTS, dtype=torch.float64
        )
        by_colour = torch.linspace(_COLOURS_NM[0], _COLOURS_NM[-1], 41).tolist()
        low, high = self.sharp_um
        return ColourCurves(
            self.medium.name,
            poured.value * _UM_TO_MM,
            poured.plus_minus * _UM_TO_MM,
            (low * _UM_TO_MM, high * _UM_TO_MM),
            tuple(
                (nm, self._at(nm, poured.value)[0] * _UM_TO_MM)
                for nm in by_colour
                if self._covers(nm)
            ),
            tuple((thicknesses * _UM_TO_MM).tolist()),
            {
                nm: tuple(self._at(nm, thicknesses)[1].tolist())
                for nm in _CURVES_NM
                if self._covers(nm)
            },
        )

    def camera(self) -> Camera:
        """The camera with this replica as its mask.

        Raises
        ------
        OptionError
            If the camera's relief is not one of lenslets of one radius.
        """
        case, camera = self.case, self.case.loaded.camera
        relief = camera.mask.relief
        if not isinstance(relief, RandomLenslets):
            raise OptionError(
                f"the relief of {camera.name!r} is of kind {relief.kind}, which no radius "
                "describes: leave -o out and write the thickness into a copy of its camera.toml"
            )
        pitch_um = case.pitch.value
        lenslets = relief.model_copy(
            update={
                "radius": Length.of(round(self.radius.value * _UM_TO_MM, 4), "mm"),
                "pitch": Length.of(pitch_um, "um"),
                "smoothing": Length.of(round(case.rounding * pitch_um, 6), "um"),
            }
        )
        layers = [self.medium.layer("resin", round(self.figures["thickness"].value, 1))]
        layers += [
            layer.medium.layer(layer.name, layer.thickness.value)
            for layer in case.cover
            if layer.thickness.value > 0
        ]
        materials = {
            each.material.name: each.material for each in self._media if each.material is not None
        }
        sensor = camera.sensor.model_copy(
            update={
                "quantum_efficiency": case.loaded.quantum_efficiency,
                "acceptance": case.loaded.acceptance,
            }
        )
        return camera.model_copy(
            update={
                "name": f"{camera.name}, {self.medium.name}",
                "note": f"{camera.note} The thickness of the resin is that of nolens design "
                f"thickness for {case.wavelength}.".strip(),
                "layers": tuple(layers),
                "materials": tuple(
                    each for name, each in materials.items() if name not in MATERIALS
                ),
                "sensor": sensor,
                "mask": Mask(surface=0, relief=lenslets, aperture=camera.mask.aperture),
            }
        )

    def summary(self) -> dict[str, Any]:
        """Figures of the replica, in values that JSON has."""
        index = self.medium.at(self.case.wavelength.nm)
        summary = {"material": self.medium.name, "index": index.summary()}
        for name, figure in self.figures.items():
            unit, scale = _UNITS.get(name, ("_mm", _UM_TO_MM))
            summary[f"{name}{unit}"] = figure.summary(scale)
        printed_um = self.printed_thickness_um
        return summary | {
            "sharp_mm": [each * _UM_TO_MM for each in self.sharp_um],
            "sharp_means": (
                f"lines at most {100 * (SHARP_LINE_RATIO - 1):.0f} % wider than in focus"
            ),
            "printed_thickness_mm": None if printed_um is None else printed_um * _UM_TO_MM,
            "colours": [asdict(each) for each in self.colours],
        }

    @property
    def _media(self) -> tuple[Medium, ...]:
        """All that light passes behind the lenslets."""
        return (self.medium, *(layer.medium for layer in self.case.cover))

    def _covers(self, wavelength_nm: float) -> bool:
        """Whether the indices of all that the replica needs are known at a wavelength."""
        return all(each.covers(wavelength_nm) for each in self._media)

    def _at(self, wavelength_nm: float, thickness_um: float | Tensor) -> tuple[float, Tensor]:
        """Thickness in focus in another light, and width of the lines behind given ones.

        The master is the same: its radius is that found in the light it was measured in.
        """
        case = replace(self.case, master=Uncertain(self.radius.value))
        values = {
            name: _scalar(each.value)
            for name, each in case.inputs(wavelength_nm, self.medium).items()
        }
        replica = case.replica_of(values)
        width = replica.width_um(thickness_um, wavelength_nm * 1e-3, values["pitch"], case.rounding)
        return float(replica.thickness_um), width


def thickness_summary(designs: tuple[ReplicaDesign, ...]) -> dict[str, Any]:
    """Figures of all replicas of one case, in values that JSON has."""
    case, radius = designs[0].case, designs[0].radius
    wavelength_nm, printed_um = case.wavelength.nm, case.printed_radius_um
    return {
        "camera": case.loaded.camera.name,
        "wavelength_nm": wavelength_nm,
        "distance_mm": None if math.isinf(case.source_um) else case.source_um * _UM_TO_MM,
        "film": case.master.summary(wavelength_nm) if isinstance(case.master, Master) else None,
        "cover": [layer.summary(wavelength_nm) for layer in case.cover],
        "pitch_um": case.pitch.summary(),
        "radius_mm": radius.summary(_UM_TO_MM),
        "printed_radius_mm": None if printed_um is None else printed_um * _UM_TO_MM,
        "materials": [each.summary() for each in designs],
    }


def cover_layers(
    loaded: LoadedCamera,
    *,
    bare: bool,
    glass: Uncertain | None,
    glass_medium: Medium | None,
    gap: Uncertain | None,
) -> tuple[_CoverLayer, ...]:
    """What stays on a sensor when the mask is taken away, with changes.

    Parameters
    ----------
    loaded
        The camera.
    bare
        Nothing stays.
    glass, glass_medium
        Thickness and medium of the cover glass, where they are not the camera's.
    gap
        Air between glass and sensor, where it is not the camera's.

    Raises
    ------
    OptionError
        If there is no glass, or more than one, that could be changed.
    """
    layers = [] if bare else _under_the_mask(loaded)
    solid = [place for place, (_, medium) in enumerate(layers) if not medium.is_air]
    if glass or glass_medium:
        if len(solid) > 1:
            raise OptionError(
                f"{loaded.camera.name!r} has {len(solid)} layers over its sensor that are no air, "
                "so there is no one glass to change: describe it in a camera.toml instead"
            )
        if solid:
            thickness, medium = layers[solid[0]]
            layers[solid[0]] = glass or thickness, glass_medium or medium
        elif glass and glass_medium:
            layers, solid = [(glass, glass_medium), *layers], [0]
        else:
            raise OptionError(
                f"{loaded.camera.name!r} has no cover glass: give both --glass, its thickness, "
                "and --glass-material"
            )
    if gap is not None:
        if layers and layers[-1][1].is_air:
            del layers[-1]
        layers.append((gap, Medium.of_material(MATERIALS["air"])))
    named = []
    for place, (thickness, medium) in enumerate(layers):
        name = f"layer {place}"
        if [place] == solid:
            name = "glass"
        elif place == len(layers) - 1 and medium.is_air:
            name = "gap"
        named.append(_CoverLayer(name, thickness, medium))
    return tuple(named)


def _under_the_mask(loaded: LoadedCamera) -> list[tuple[Uncertain, Medium]]:
    """Layers of the camera behind that of its mask, but for air between that and a solid one."""
    camera = loaded.camera
    layers = [
        (Uncertain(layer.thickness.um), _medium_of(camera, layer))
        for layer in camera.layers[camera.mask.surface + 1 :]
    ]
    first = next((place for place, (_, medium) in enumerate(layers) if not medium.is_air), 0)
    return layers[first:]


def _medium_of(camera: Camera, layer: Layer) -> Medium:
    material = camera.material_of(layer)
    if material is not None:
        return Medium.of_material(material)
    assert layer.index is not None
    return Medium.of_index(Uncertain(layer.index))


def _scalar(value: float) -> Tensor:
    return torch.tensor(value, dtype=torch.float64)
