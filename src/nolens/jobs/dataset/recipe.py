"""What a recipe of a data set comes to: views, scenes, items and shards."""

import hashlib
import json
import math
import os
from dataclasses import asdict, dataclass, replace
from functools import cached_property
from importlib.metadata import version
from pathlib import Path
from typing import Any

import tomli_w
import torch

from nolens.camera.psf_set import Depth
from nolens.camera.toml import PRESETS, preset_text
from nolens.errors import DataError, FileError, OptionError
from nolens.experiments.dataset_items import (
    HELD_BYTES,
    ItemSettings,
    View,
    crop_sides,
    draw_item,
    scene_of_item,
    split_of_scenes,
)
from nolens.files import InputFile, camera_files, readable
from nolens.files.dataset import COLUMNS, SPLITS, SUFFIXES, DatasetCamera, Row
from nolens.files.pictures import picture_files, picture_size
from nolens.jobs.dataset.options import DatasetOptions
from nolens.jobs.run import Run
from nolens.machine import BYTES_OF_PROGRAM
from nolens.twin import Plane, check_simulation_memory, distance_um
from nolens.twin.model import relief_points, simulation_bytes

_WITHOUT_EFFECT = {"recipe", "output", "items", "workers", "scheduler"}
"""Options that items do not depend on."""
_NEEDS_LESS = "a camera with fewer pixels or a smaller --angle needs less"


@dataclass(frozen=True)
class Views:
    """Cameras with all masks at all distances, by number."""

    cameras: tuple[View, ...]
    masks: int
    distances: tuple[Depth | None, ...]

    @property
    def counts(self) -> tuple[int, int, int]:
        """Numbers of cameras, masks of each, and distances."""
        return len(self.cameras), self.masks, len(self.distances)

    def __len__(self) -> int:
        return math.prod(self.counts)

    def parts(self, number: int) -> tuple[int, int, int]:
        """Numbers of the camera, the mask and the distance."""
        rest, distance = divmod(number, len(self.distances))
        return *divmod(rest, self.masks), distance

    def distance(self, number: int) -> str:
        """Such as "300 mm"."""
        camera, _, distance = self.parts(number)
        own = self.cameras[camera].loaded.camera.reference_distance
        return str(self.distances[distance] or own)

    def __getitem__(self, number: int) -> View:
        camera, mask, distance = self.parts(number)
        view = self.cameras[camera]
        away_um = distance_um(self.distances[distance], view.loaded)
        return replace(view, distance_um=away_um).with_mask(mask)

    def name(self, number: int) -> str:
        """Of the PSF."""
        return f"psf-{number:0{len(str(len(self) - 1))}d}"

    def worker_bytes(self) -> float:
        """Most memory that a worker needs.

        Raises
        ------
        NolensError
            If a camera cannot look at a distance, has no other masks, or needs more memory than
            the machine has.
        """
        most = 0.0
        for camera in range(len(self.cameras)):
            for distance in range(len(self.distances)):
                view = self[(camera * self.masks + self.masks - 1) * len(self.distances) + distance]
                experiment = view.experiment()
                down, aside = (
                    float(each.abs().max()) for each in view.field(experiment.twin).tangents()
                )
                scene = torch.zeros(len(view.loaded.camera.sensor.channels), 2, 2)
                full_deg = 2 * math.degrees(math.atan(max(down, aside)))
                working = experiment.scene_bytes((Plane(scene, full_deg, view.distance_um),))
                check_simulation_memory(view.loaded, working, torch.device("cpu"), _NEEDS_LESS)
                most = max(most, simulation_bytes(relief_points(view.loaded), working))
        return BYTES_OF_PROGRAM + most + HELD_BYTES


@dataclass(frozen=True)
class Scenes:
    """Pictures in a folder, or of a generator.

    Parameters
    ----------
    folder
        None for a generator.
    names
        Of the files in the folder.
    contents
        A number for what each shows.
    """

    folder: Path | None
    names: tuple[str, ...]
    contents: tuple[int, ...]

    @classmethod
    def of(cls, run: Run[DatasetOptions]) -> "Scenes":
        """List and hash them.

        Raises
        ------
        FileError
            If the folder has none.
        OptionError
            If the data set would be written among them.
        """
        options = run.options
        folder = options.scenes
        if folder is None:
            names = (f"{options.generator} {each}" for each in range(options.count))
            return cls(None, tuple(names), tuple(range(options.count)))
        if not folder.is_dir():
            raise FileError(f"{folder} is no folder: give one with pictures (--scenes)")
        if folder.resolve() in (options.output.resolve(), *options.output.resolve().parents):
            raise OptionError(
                f"{options.output} lies in the folder of the pictures, {folder}: give another (-o)"
            )
        paths = [path for path in picture_files(folder, below=True) if path.is_file()]
        contents = []
        for number, path in enumerate(paths):
            run.reporter.advance("pictures", number / len(paths))
            contents.append(int(InputFile.of(path).sha256, 16))
        return cls(folder, tuple(str(path.relative_to(folder)) for path in paths), tuple(contents))

    @cached_property
    def sha256(self) -> str:
        """Of all names and contents."""
        digest = hashlib.sha256()
        for name, content in zip(self.names, self.contents, strict=True):
            digest.update(f"{content:064x} {name}\n".encode(errors="surrogateescape"))
        return digest.hexdigest()

    def check_sizes(self, views: Views) -> None:
        """Refuse pictures with fewer pixels than the truth of a camera.

        Raises
        ------
        DataError
            If there are such.
        FileError
            If a picture cannot be read.
        """
        if self.folder is None:
            return
        needs = []
        for view in views.cameras:
            support = view.field(view.experiment().twin).support
            sensor = view.loaded.camera.sensor
            needs.append((sensor.rows / sensor.columns, (support.height, support.width)))
        small, first = 0, ""
        for name in self.names:
            size = picture_size(self.folder / name)
            try:
                for aspect, least in needs:
                    crop_sides(size, aspect, least, 1.0)
            except DataError as error:
                small, first = small + 1, first or f"{self.folder / name}: {error}"
        if small:
            raise DataError(
                f"{small} of {len(self.names)} pictures are too small; the first is {first}"
            )


class Recipe:
    """A recipe that was read and checked.

    Parameters
    ----------
    run
        Of the job.

    Raises
    ------
    NolensError
        If a camera, a distance or a picture cannot be used.
    """

    def __init__(self, run: Run[DatasetOptions]) -> None:
        options = self.options = run.options
        loaded = [run.camera(name) for name in options.camera]
        self.views = Views(
            tuple(
                View(
                    each,
                    distance_um(None, each),
                    None if options.angle is None else options.angle.deg,
                    options.light,
                    options.wavelengths,
                    options.field_points,
                    options.fresnel,
                )
                for each in loaded
            ),
            options.masks,
            options.distance or (None,),
        )
        self.worker_bytes = self.views.worker_bytes()
        self.scenes = Scenes.of(run)
        self.scenes.check_sizes(self.views)
        self.cameras = tuple(
            DatasetCamera(name=each.camera.name, sha256=_hashes(name, each))
            for name, each in zip(options.camera, loaded, strict=True)
        )
        validation, test = options.validation.value, options.test.value
        self._split = split_of_scenes(options.seed, self.scenes.contents, validation, test)
        self._variation = options.variation

    def scene(self, index: int) -> int:
        """Number of an item's picture."""
        if self.scenes.folder is None:
            return index
        return scene_of_item(self.options.seed, index, len(self.scenes.names))

    def settings(self, index: int) -> ItemSettings:
        """What is drawn for an item."""
        return draw_item(
            self._variation,
            self.views.counts,
            seed=self.options.seed,
            index=index,
            scene=self.scene(index),
        )

    def load(self, index: int) -> tuple[ItemSettings, str, bytes]:
        """What a worker needs for an item, which may have no folder in common with this machine."""
        settings = self.settings(index)
        if self.scenes.folder is None:
            return settings, "", b""
        path = self.scenes.folder / self.scenes.names[settings.scene]
        return settings, str(path), path.read_bytes()

    def row(self, index: int, made: dict[str, Any]) -> Row:
        """Columns of an item."""
        settings = self.settings(index)
        row = {
            **asdict(settings),
            **made,
            "scene": readable(self.scenes.names[settings.scene]),
            "psf": self.views.name(settings.view),
            "crop_down": settings.crop_at[0],
            "crop_right": settings.crop_at[1],
        }
        return {name: row[name] for name in COLUMNS}

    @cached_property
    def shards(self) -> dict[str, tuple[str, list[int]]]:
        """Split and items of each shard, by its name in the folder."""
        options = self.options
        items: dict[str, list[int]] = {split: [] for split in SPLITS}
        for index in range(options.count):
            items[self._split[self.scene(index)]].append(index)
        shards = {}
        for split, numbers in items.items():
            total = math.ceil(len(numbers) / options.shard)
            for number in range(total):
                name = f"data/{split}-{number:05d}-of-{total:05d}{SUFFIXES[options.layout]}"
                first = number * options.shard
                shards[name] = split, numbers[first : first + options.shard]
        return shards

    @cached_property
    def values(self) -> dict[str, Any]:
        """Options that the items depend on, in values that JSON has; of paths the last part."""
        values = self.options.model_dump(mode="json", exclude=_WITHOUT_EFFECT)
        if self.options.scenes is not None:
            values["scenes"] = readable(self.options.scenes.resolve().name)
        values["camera"] = [readable(Path(name).name) for name in self.options.camera]
        return values

    @property
    def identity(self) -> dict[str, str]:
        """What a folder's items depend on, as texts by name."""
        texts = {key: json.dumps(value) for key, value in self.values.items()}
        for number, camera in enumerate(self.cameras, start=1):
            texts[f"camera {number} ({camera.name})"] = json.dumps(camera.sha256)
        texts["set of pictures"] = self.scenes.sha256
        return {"version of nolens": version("nolens"), **texts}

    def toml(self) -> str:
        """Recipe that makes the same set again; paths start from its folder."""
        options = self.options
        values = {name: self.values[name] for name in sorted(self.values.keys())}
        values = {name: value for name, value in values.items() if name in options.model_fields_set}
        if options.scenes is not None:
            values["scenes"] = self._from_folder(options.scenes)
        if "camera" in values:
            values["camera"] = [
                name if name in PRESETS else self._from_folder(Path(name))
                for name in options.camera
            ]
        return tomli_w.dumps(values)

    def _from_folder(self, path: Path) -> str:
        return readable(os.path.relpath(path, self.options.output))


def _hashes(name: str, loaded: Any) -> dict[str, str]:
    """SHA-256 of the files that describe a camera, by role."""
    files = camera_files(name, loaded.camera)
    if not files:
        return {"preset": hashlib.sha256(preset_text(name).encode()).hexdigest()}
    return {role: InputFile.of(path).sha256 for role, path in files.items()}
