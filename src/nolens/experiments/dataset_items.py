"""Items of a data set: what is drawn for each from a seed, and its measurement and truth."""

import math
from collections import OrderedDict
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from nolens.camera import Frame, LoadedCamera, RandomLenslets
from nolens.camera.measurement import rgb_counts
from nolens.errors import DataError
from nolens.experiments.virtual_experiment import VirtualExperiment
from nolens.optics import PointSource
from nolens.twin import (
    FieldMap,
    FieldModel,
    Light,
    Twin,
    expose,
    half_field,
    in_channels,
    pixel_currents,
    preview_model,
)

LARGEST = 65535
"""Of the whole numbers that measurement and truth are stored as."""
_ITEM, _ORDER, _SPLIT, _SCENE = range(4)
"""What random numbers are for, so that none is used twice."""

HELD_BYTES = 1e9
"""Most memory for PSFs that were computed and may be needed again."""

Range = tuple[float, float]
"""Smallest and largest value."""


@dataclass(frozen=True)
class Variation:
    """What differs from item to item; each value is drawn between two.

    Parameters
    ----------
    crop
        Side of the part of a picture that is shown, over that of the largest that fits.
    mirror
        Whether every second picture is mirrored.
    fill
        Fraction of a full pixel that the brightest one is exposed to.
    exposure_s
        Exposure time, in place of `fill`.
    gain
        Factor on the sensor's own gain.
    read_noise
        In electrons; None takes the sensor's.
    psf_scale, psf_rotation_deg, psf_blur_pixels
        How the camera's PSF differs from the one that belongs to the item (`FieldModel.altered`).
    haze
        Light that falls evenly on the sensor, over the mean of the light of the scene.
    banding_counts
        Standard deviation of an offset of each row.
    black_error_counts
        True black level minus the stated one.
    """

    crop: Range = (1.0, 1.0)
    mirror: bool = False
    fill: Range = (0.9, 0.9)
    exposure_s: Range | None = None
    gain: Range = (1.0, 1.0)
    read_noise: Range | None = None
    psf_scale: Range = (1.0, 1.0)
    psf_rotation_deg: Range = (0.0, 0.0)
    psf_blur_pixels: Range = (0.0, 0.0)
    haze: Range = (0.0, 0.0)
    banding_counts: Range = (0.0, 0.0)
    black_error_counts: Range = (0.0, 0.0)


@dataclass(frozen=True)
class ItemSettings:
    """All that was drawn for an item; the fields are those of `Variation`.

    Parameters
    ----------
    index
        Number of the item.
    scene
        Number of its picture.
    view
        Number of the camera, mask and distance.
    crop_at
        Where the part of the picture lies in what is left, 0 to 1: down and to the right.
    noise_seed
        Of the sensor's noise.
    """

    index: int
    scene: int
    view: int
    crop: float
    crop_at: tuple[float, float]
    mirrored: bool
    fill: float | None
    exposure_s: float | None
    gain: float
    read_noise: float | None
    psf_scale: float
    psf_rotation_deg: float
    psf_blur_pixels: float
    haze: float
    banding_counts: float
    black_error_counts: float
    noise_seed: int


def random_numbers(seed: int, *use: int) -> np.random.Generator:
    """Random numbers that depend on a seed and their use alone."""
    return np.random.Generator(np.random.Philox(np.random.SeedSequence(seed, spawn_key=use)))


def scene_of_item(seed: int, index: int, scenes: int) -> int:
    """Number of an item's picture: all are shown once, in random order, then all again."""
    turn, place = divmod(index, scenes)
    return int(_order(seed, turn, scenes)[place])


@lru_cache(maxsize=4)
def _order(seed: int, turn: int, scenes: int) -> NDArray[np.int64]:
    return random_numbers(seed, _ORDER, turn).permutation(scenes)


def scene_seed(seed: int, scene: int) -> int:
    """Of a generated picture."""
    return int(random_numbers(seed, _SCENE, scene).integers(2**63))


def split_of_scenes(
    seed: int, contents: Sequence[int], validation: float, test: float
) -> list[str]:
    """``train``, ``validation`` or ``test`` for each scene; scenes of equal content go together.

    Parameters
    ----------
    seed
        Of the data set.
    contents
        A number for each scene that says what it shows, such as a hash.
    validation, test
        Fractions of the scenes.
    """
    distinct = sorted(set(contents))
    order = random_numbers(seed, _SPLIT).permutation(len(distinct))
    first, second = round(test * len(distinct)), round((test + validation) * len(distinct))
    names = ["test"] * first + ["validation"] * (second - first)
    names += ["train"] * (len(distinct) - len(names))
    split = {distinct[place]: name for place, name in zip(order, names, strict=True)}
    return [split[each] for each in contents]


def draw_item(
    variation: Variation, views: tuple[int, int, int], *, seed: int, index: int, scene: int
) -> ItemSettings:
    """Draw an item. Another range changes no other value, and no other item.

    Exposure, gain and read noise are even on a logarithmic scale, the rest on a linear one.

    Parameters
    ----------
    variation
        The ranges.
    views
        Numbers of cameras, of masks of each, and of distances.
    seed
        Of the data set.
    index, scene
        As `ItemSettings` has them.
    """
    random = random_numbers(seed, _ITEM, index)
    uniform = iter(random.random(32).tolist())

    def even(between: Range) -> float:
        place: float = next(uniform)
        return between[0] + place * (between[1] - between[0])

    def logarithmic(between: Range) -> float:
        low, high = (math.log(max(each, 1e-300)) for each in between)
        return min(max(math.exp(low + next(uniform) * (high - low)), between[0]), between[1])

    view = 0
    for count in views:
        view = view * count + min(int(next(uniform) * count), count - 1)
    crop, crop_at = even(variation.crop), (next(uniform), next(uniform))
    mirrored = next(uniform) < 0.5 and variation.mirror
    exposure = logarithmic(variation.exposure_s or variation.fill)
    gain = logarithmic(variation.gain)
    read_noise = logarithmic(variation.read_noise or (1, 1))
    return ItemSettings(
        index=index,
        scene=scene,
        view=view,
        crop=crop,
        crop_at=crop_at,
        mirrored=mirrored,
        fill=exposure if variation.exposure_s is None else None,
        exposure_s=exposure if variation.exposure_s is not None else None,
        gain=gain,
        read_noise=read_noise if variation.read_noise is not None else None,
        psf_scale=even(variation.psf_scale),
        psf_rotation_deg=even(variation.psf_rotation_deg),
        psf_blur_pixels=even(variation.psf_blur_pixels),
        haze=even(variation.haze),
        banding_counts=even(variation.banding_counts),
        black_error_counts=even(variation.black_error_counts),
        noise_seed=int(random.integers(2**63)),
    )


@dataclass(frozen=True)
class View:
    """A camera that looks at scenes of one distance.

    Parameters
    ----------
    loaded
        The camera.
    distance_um
        Of the scenes.
    angle_deg
        Field angle of the truth's longer side; None takes 40°, or what an aperture leaves of it.
    light, wavelengths, field_points, fresnel
        As `nolens.experiments.VirtualExperiment` takes them.
    """

    loaded: LoadedCamera
    distance_um: float
    angle_deg: float | None = None
    light: str = "white-led"
    wavelengths: int = 3
    field_points: int = 1
    fresnel: bool = True

    def with_mask(self, number: int) -> "View":
        """The same with another mask of random lenslets, of which 0 is the camera's own.

        Raises
        ------
        DataError
            If the camera's mask is no random one.
        """
        relief = self.loaded.camera.mask.relief
        if number == 0:
            return self
        if not isinstance(relief, RandomLenslets):
            raise DataError(
                f"the mask of {self.loaded.camera.name!r} is of kind {relief.kind}, of which there "
                "is one: several --masks are drawn for cameras with random lenslets; give a "
                "--camera for each mask"
            )
        seed = (relief.seed + number) % 2**63
        return replace(
            self, loaded=self.loaded.with_relief(relief.model_copy(update={"seed": seed}))
        )

    def field(self, twin: Twin) -> FieldMap:
        """Pixels of the truth, for the camera or its preview.

        Raises
        ------
        OptionError
            If distance or angle are beyond the model.
        """
        twin.check_source(PointSource(distance_um=self.distance_um))
        if self.angle_deg is None:
            return FieldMap.covering(twin, half_field(twin, 40.0))
        longer = math.tan(math.radians(self.angle_deg / 2))
        sensor = twin.camera.sensor
        sides = (sensor.rows, sensor.columns)
        return FieldMap.covering(
            twin, (longer * sides[0] / max(sides), longer * sides[1] / max(sides))
        )

    def experiment(self, twin: Twin | None = None) -> VirtualExperiment:
        """The camera in the view's light; its preview model where no twin is given."""
        if twin is None:
            twin = preview_model(self.loaded, fresnel=self.fresnel)
        return VirtualExperiment(twin, Light(self.light), self.wavelengths, self.field_points)

    def model(self, twin: Twin) -> FieldModel:
        """Compute its PSFs."""
        return FieldModel.of(
            twin,
            self.field(twin),
            distance_um=self.distance_um,
            light=Light(self.light),
            wavelengths=self.wavelengths,
            field_points=self.field_points,
        )


class Models:
    """PSFs of some views, computed when they are needed; those used last are held.

    Parameters
    ----------
    view
        Gives the view of a number.
    """

    def __init__(self, view: Callable[[int], View]) -> None:
        self._view = view
        self._models: OrderedDict[int, FieldModel] = OrderedDict()
        self._twin: tuple[LoadedCamera, Twin] | None = None

    def twin(self, view: View) -> Twin:
        """The camera of a view; one is held, with its relief."""
        before = None if self._twin is None else self._twin[0]
        now = view.loaded
        if before is None or before.camera != now.camera or before.relief_um is not now.relief_um:
            self._twin = None
            self._twin = now, Twin.of(now, fresnel=view.fresnel)
        assert self._twin is not None
        return self._twin[1]

    def __getitem__(self, number: int) -> FieldModel:
        if number not in self._models:
            view = self._view(number)
            self._models[number] = view.model(self.twin(view))
            while len(self._models) > 1 and self._held > HELD_BYTES:
                self._models.popitem(last=False)
        self._models.move_to_end(number)
        return self._models[number]

    @property
    def _held(self) -> int:
        return sum(each.working_bytes for each in self._models.values())


@dataclass(frozen=True)
class Item:
    """Measurement and truth of an item.

    Parameters
    ----------
    frame
        The counts that the sensor gives.
    truth
        Radiance of the scene, (channels, height, width).
    figures
        Exposure and saturation, by name.
    """

    frame: Frame
    truth: Tensor
    figures: dict[str, float]

    def stored_measurement(self, *, developed: bool) -> tuple[NDArray[np.uint16], float, float]:
        """The measurement in whole numbers, and the factor and offset of its values.

        Developed, a value is that of a superpixel in R, G and B, above the stated black level.
        """
        frame = self.frame
        if not developed:
            return _whole(frame.counts), 1.0, 0.0
        # Green is the mean of two pixels: halves of a count, where sixteen bits hold them.
        steps = 2 if frame.mosaic is not None and float(frame.white or 0) * 2 <= LARGEST else 1
        return _whole(rgb_counts(frame) * steps), 1 / steps, -frame.black[0]

    def stored_truth(self) -> tuple[NDArray[np.uint16], float]:
        """The truth in whole numbers, and the factor of its values."""
        scale = max(1.0, float(self.truth.max())) / LARGEST
        return _whole(self.truth / scale), scale


def simulate_item(
    settings: ItemSettings, model: FieldModel, picture: Tensor, luminance_cd_m2: float
) -> Item:
    """Measure a picture.

    Parameters
    ----------
    settings
        As `draw_item` gives them.
    model
        The camera at the item's distance.
    picture
        Linear radiance, (3, height, width); 1 is white.
    luminance_cd_m2
        Of white.
    """
    twin = model.twin
    sensor = twin.camera.sensor
    truth = model.rendered(
        in_channels(_crop(picture, settings, model), len(sensor.channels)), whole=False
    )
    camera = model.altered(
        scale=settings.psf_scale,
        rotation_rad=math.radians(settings.psf_rotation_deg),
        blur_pixels=settings.psf_blur_pixels,
    )
    current = pixel_currents(twin, model.illuminant, luminance_cd_m2)

    def rate_of(scene: Tensor) -> Tensor:
        rate = camera.light(scene).mul_(current)
        return rate.add_(settings.haze * float(rate.double().mean()))

    rate = rate_of(truth)
    used = sensor.model_copy(update={"gain": sensor.gain * settings.gain})
    if settings.read_noise is not None:
        used = used.model_copy(update={"read_noise_electrons": settings.read_noise})
    exposure_s = settings.exposure_s
    if exposure_s is None:
        assert settings.fill is not None
        # Of a black picture, as of a white one.
        most = float(rate.max()) or float(rate_of(torch.ones_like(truth)).max())
        exposure_s = settings.fill * used.clip_electrons / most
    rows = torch.randn(
        sensor.rows, 1, generator=torch.Generator().manual_seed(settings.noise_seed ^ 1)
    )
    counts = expose(
        rate * exposure_s,
        used,
        seed=settings.noise_seed,
        offset_counts=settings.black_error_counts + settings.banding_counts * rows,
    )
    white = float(used.saturated_counts)
    frame = Frame(
        counts.float()[None],
        ("grey",) if sensor.mosaic == "none" else ("mosaic",),
        None if sensor.mosaic == "none" else sensor.mosaic,
        (sensor.black_counts,),
        white,
        "uint16",
        f"item {settings.index}",
        exposure_s,
        black_stated=True,
    )
    figures = {
        "exposure_s": exposure_s,
        "gain": used.gain,
        "read_noise_electrons": used.read_noise_electrons,
        "brightest_electrons": float(rate.max()) * exposure_s,
        "saturated_fraction": float((counts >= white).double().mean()),
        "black_counts": sensor.black_counts,
        "white_counts": white,
    }
    return Item(frame, truth, figures)


def crop_sides(
    size: tuple[int, int], aspect: float, support: tuple[int, int], fraction: float
) -> tuple[int, int]:
    """Height and width of the part of a picture that is shown; not smaller than the truth.

    Parameters
    ----------
    size
        Of the picture.
    aspect
        Height over width of what fills the field.
    support
        Height and width of the truth.
    fraction
        Of the largest part that fits.

    Raises
    ------
    DataError
        If the picture is smaller than the truth.
    """
    width = min(size[1], size[0] / aspect)
    # Lines of the truth are less dense towards the field's edges: its width stands for both.
    if width + 1 < support[1]:
        raise DataError(
            f"it has {size[0]}×{size[1]} pixels, and the truth {support[0]}×{support[1]}: give "
            "larger pictures, or a smaller --angle"
        )
    width = min(width, max(fraction * width, support[1]))
    return min(size[0], round(width * aspect)), min(size[1], round(width))


def _crop(picture: Tensor, settings: ItemSettings, model: FieldModel) -> Tensor:
    height, width = picture.shape[-2:]
    support = model.field.support
    rows, columns = crop_sides(
        (height, width), model.aspect, (support.height, support.width), settings.crop
    )
    top = round(settings.crop_at[0] * (height - rows))
    left = round(settings.crop_at[1] * (width - columns))
    part = picture[:, top : top + rows, left : left + columns]
    return part.flip(-1) if settings.mirrored else part


def _whole(values: Tensor) -> NDArray[np.uint16]:
    """Whole numbers of 16 bits, (height, width, 1 or 3)."""
    whole = values.round().clamp(0, LARGEST).to(torch.int32).permute(1, 2, 0)
    return np.ascontiguousarray(whole.numpy().astype(np.uint16))
