"""The sensor, the master and the replicas that `nolens design thickness` is asked about."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Self

from torch import Tensor

from nolens.camera import Layer, Material, OpenCamera, RandomLenslets
from nolens.design.replica import Cover, Film, Replica
from nolens.design.uncertain import Uncertain
from nolens.errors import OptionError
from nolens.files import read_camera, read_material
from nolens.jobs.designing.thickness_options import ThicknessOptions
from nolens.optics import Number
from nolens.quantities import Length

_PAPER_FILM = Uncertain(305.0)
"""0.012 inch; the paper gives no thickness, and with this one its figures come out."""
_PAPER_FILM_MATERIAL = "polycarbonate"
_PAPER_DISTANCE = Uncertain(400.0, 200.0)
_PAPER_REPLICAS = ("pdms", "pua311")
_AIR = 1.0

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
    def given(cls, material: str | None, index: Uncertain | None) -> Self:
        """Read a material by name or from a file, or take an index."""
        if index is not None:
            return cls(f"n {index.value:g}", None, index)
        assert material is not None
        found = read_material(material)
        return cls(found.name, found)

    def at(self, wavelength_nm: float) -> Uncertain:
        """Refractive index at a wavelength."""
        if self.material is not None:
            return Uncertain(self.material.index(wavelength_nm))
        assert self.index is not None
        return self.index

    def layer(self, name: str, thickness_um: float) -> Layer:
        """A layer of it."""
        thickness = Length.of(round(thickness_um * 1e-3, 9), "mm")
        if self.material is not None:
            return Layer(name=name, thickness=thickness, material=self.material.name)
        return Layer(name=name, thickness=thickness, index=self.at(0.0).value)


@dataclass(frozen=True)
class CoverLayer:
    """One of the layers over the sensor."""

    name: str
    thickness: Uncertain
    medium: Medium


@dataclass(frozen=True)
class Case:
    """All that is known before anything is computed.

    Parameters
    ----------
    opened
        The camera.
    cover
        What lies over its sensor, from the scene.
    film
        Medium of the master, its thickness and distance, and where it faces; None where the
        radius is known.
    radius
        That radius.
    replicas
        Materials of the replica.
    pitch
        Of the lenslets.
    rounding
        Of their valleys, over the pitch.
    options
        The rest of what was asked.
    """

    opened: OpenCamera
    cover: tuple[CoverLayer, ...]
    film: tuple[Medium, Uncertain, Uncertain] | None
    radius: Uncertain | None
    replicas: tuple[Medium, ...]
    pitch: Uncertain
    rounding: float
    options: ThicknessOptions

    @classmethod
    def of(cls, options: ThicknessOptions) -> Self:
        """Read the camera and the materials.

        Raises
        ------
        NolensError
            If one cannot be read, or the options do not fit the camera.
        """
        opened = read_camera(options.camera)
        film = None
        if options.radius is None:
            material = None if options.film_index else options.film_material
            medium = Medium.given(material or _PAPER_FILM_MATERIAL, options.film_index)
            film = medium, options.film or _PAPER_FILM, options.film_distance or _PAPER_DISTANCE
        replicas = [Medium.given(None, index) for index in options.index]
        names = options.material or (() if options.index else _PAPER_REPLICAS)
        replicas += [Medium.given(name, None) for name in names]
        pitch, rounding = _lenslets(opened, options)
        return cls(
            opened,
            _cover(opened, options),
            film,
            options.radius,
            tuple(replicas),
            pitch,
            rounding,
            options,
        )

    def inputs(self, wavelength_nm: float, replica: Medium) -> dict[str, Uncertain]:
        """Every quantity that the figures of a replica follow from, by name; lengths in um."""
        found: dict[str, Uncertain] = {}
        if self.film is not None:
            medium, thickness, distance = self.film
            found |= {
                "film": thickness,
                "film index": medium.at(wavelength_nm),
                "film distance": distance,
            }
        else:
            assert self.radius is not None
            found["radius"] = self.radius
        for layer in self.cover:
            found[layer.name] = layer.thickness
            found[f"{layer.name} index"] = layer.medium.at(wavelength_nm)
        return found | {"replica index": replica.at(wavelength_nm), "pitch": self.pitch}

    def cover_of(self, values: Values) -> Cover:
        """The layers over the sensor, of such quantities."""
        names = [layer.name for layer in self.cover]
        return Cover(
            tuple(values[name] for name in names),
            tuple(values[f"{name} index"] for name in names),
        )

    def film_of(self, values: Values) -> Film | None:
        """The master, of such quantities."""
        if self.film is None:
            return None
        side = self.options.film_side or "scene"
        return Film(values["film"], values["film index"], values["film distance"], side)

    def radius_of(self, values: Values) -> Number:
        """The radius, given or from the film."""
        film = self.film_of(values)
        if film is None:
            return values["radius"]
        return film.over(self.cover_of(values), 1.0, self.options.source_um).focused_radius_um()

    def replica_of(self, values: Mapping[str, Tensor]) -> Replica:
        """The replica, of such quantities."""
        return Replica(
            values["replica index"],
            self.radius_of(values),
            self.cover_of(values),
            self.options.source_um,
        )

    def check(self) -> None:
        """Refuse a film that is none, before anything is computed.

        Raises
        ------
        OptionError
            If it has the index of air, or lies on the sensor with its relief.
        """
        if self.film is None:
            return
        medium, _, distance = self.film
        if medium.at(self.options.wavelength.nm).value <= _AIR:
            raise OptionError(
                f"the film's index of {medium.at(self.options.wavelength.nm).value:g} is that of "
                "air, so its relief bends no light: give a higher one"
            )
        behind = distance.value + sum(layer.thickness.value for layer in self.cover)
        if self.options.film_side == "sensor" and behind <= 0:
            raise OptionError(
                "the film's relief lies on the sensor itself, where it cannot be sharpest: give "
                "the --film-distance at which its pattern is"
            )


def _lenslets(opened: OpenCamera, options: ThicknessOptions) -> tuple[Uncertain, float]:
    """Pitch, and the share of it that rounds the valleys."""
    relief = opened.camera.mask.relief
    if isinstance(relief, RandomLenslets):
        pitch = options.pitch or Uncertain(relief.pitch.um)
        return pitch, relief.smoothing.um / relief.pitch.um
    if options.pitch is None:
        raise OptionError(
            f"the relief of {opened.camera.name!r} is not described by a pitch: give the distance "
            "of its lenslets, such as --pitch 70um"
        )
    return options.pitch, 0.0


def _cover(opened: OpenCamera, options: ThicknessOptions) -> tuple[CoverLayer, ...]:
    """What stays on the sensor when the mask is taken away, with the changes asked for."""
    layers = [] if options.no_glass else _under_the_mask(opened)
    solid = [place for place, (_, medium) in enumerate(layers) if not _is_air(medium)]
    if options.glass or options.glass_material or options.glass_index:
        if len(solid) > 1:
            raise OptionError(
                f"{opened.camera.name!r} has {len(solid)} layers over its sensor that are no air, "
                "so there is no one glass to change: describe it in a camera.toml instead"
            )
        if solid:
            thickness, medium = layers[solid[0]]
            if options.glass_material or options.glass_index:
                medium = Medium.given(options.glass_material, options.glass_index)
            layers[solid[0]] = options.glass or thickness, medium
        elif options.glass and (options.glass_material or options.glass_index):
            medium = Medium.given(options.glass_material, options.glass_index)
            layers, solid = [(options.glass, medium), *layers], [0]
        else:
            raise OptionError(
                f"{opened.camera.name!r} has no cover glass: give both --glass, its thickness, "
                "and --glass-material"
            )
    if options.gap is not None:
        if layers and _is_air(layers[-1][1]):
            del layers[-1]
        layers.append((options.gap, Medium.given("air", None)))
    named = []
    for place, (thickness, medium) in enumerate(layers):
        name = f"layer {place}"
        if [place] == solid:
            name = "glass"
        elif place == len(layers) - 1 and _is_air(medium):
            name = "gap"
        named.append(CoverLayer(name, thickness, medium))
    return tuple(named)


def _under_the_mask(opened: OpenCamera) -> list[tuple[Uncertain, Medium]]:
    """Layers of the camera behind that of its mask, but for air between that and a solid one."""
    camera = opened.camera
    layers = [
        (Uncertain(layer.thickness.um), _medium_of(opened, layer))
        for layer in camera.layers[camera.mask.surface + 1 :]
    ]
    first = next((place for place, (_, medium) in enumerate(layers) if not _is_air(medium)), 0)
    return layers[first:]


def _medium_of(opened: OpenCamera, layer: Layer) -> Medium:
    found = opened.camera.material_of(layer)
    if found is not None:
        return Medium(found.name, found)
    assert layer.index is not None
    return Medium(f"n {layer.index:g}", None, Uncertain(layer.index))


def _is_air(medium: Medium) -> bool:
    if medium.index is not None:
        return medium.index.value == _AIR
    assert medium.material is not None
    return medium.material.index(medium.material.range_nm[0]) == _AIR
