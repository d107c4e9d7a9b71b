"""`nolens dataset make`: a data set of simulated measurements and their truths."""

import hashlib
import json
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import closing
from dataclasses import dataclass
from functools import partial
from importlib.metadata import version
from pathlib import Path
from typing import Any

import psutil
import torch
from torch import Tensor

from nolens.amounts import duration_text, size_text
from nolens.engine import Manifest, check_scheduler, run_items, worker_count
from nolens.engine.manifest import MANIFEST_FILE
from nolens.errors import DataError, NolensError, OptionError
from nolens.experiments.dataset_items import (
    ItemSettings,
    Models,
    scene_seed,
    simulate_item,
)
from nolens.experiments.dead_leaves import dead_leaves
from nolens.files import InputFile, read_picture, write_into, write_tiff32
from nolens.files.atomic import write_text
from nolens.files.dataset import (
    CARD_FILE,
    DATASET_FILE,
    RECIPE_FILE,
    SPLITS,
    DatasetDescription,
    DatasetPsf,
    DatasetShard,
    DatasetSplit,
    Row,
    card_text,
    check_layout,
    encode_picture,
    shard_bytes,
)
from nolens.jobs.dataset.options import DatasetOptions
from nolens.jobs.dataset.recipe import Recipe, Views
from nolens.jobs.run import Product, Run, Writer, job
from nolens.kernels.threads import one_thread
from nolens.optics import PointSource

_TIMED = 3
"""Items that are made beforehand, for an estimate."""
_WORTH_A_WORD = 20


@dataclass(frozen=True)
class DatasetWork:
    """What workers do: PSFs of views, by their number, and items.

    Parameters
    ----------
    views
        Cameras, masks and distances.
    seed
        Of the data set.
    luminance_cd_m2
        Of white.
    developed
        Whether the measurements are developed.
    """

    views: Views
    seed: int
    luminance_cd_m2: float
    developed: bool

    def prepare(self) -> Callable[[Any], dict[str, Any]]:
        """Give what makes one of either; cameras are computed when they are needed."""
        return partial(self._make, Models(self.views.__getitem__))

    def _make(self, models: Models, item: int | tuple[ItemSettings, str, bytes]) -> dict[str, Any]:
        return self._psf(models, item) if isinstance(item, int) else self._item(models, *item)

    def _item(
        self, models: Models, settings: ItemSettings, name: str, data: bytes
    ) -> dict[str, Any]:
        model = models[settings.view]
        if data:
            picture = _decoded(data, name)
        else:
            width, seed = model.field.support.width, scene_seed(self.seed, settings.scene)
            picture = dead_leaves(round(width * model.aspect), width, seed)
        item = simulate_item(settings, model, picture, self.luminance_cd_m2)
        measurement, scale, offset = item.stored_measurement(developed=self.developed)
        truth, truth_scale = item.stored_truth()
        return {
            "measurement": encode_picture(measurement),
            "measurement_scale": scale,
            "measurement_offset": offset,
            "truth": encode_picture(truth),
            "truth_scale": truth_scale,
            **item.figures,
        }

    def _psf(self, models: Models, number: int) -> dict[str, Any]:
        view = self.views[number]
        twin = models.twin(view)
        field = view.field(twin)
        support = field.support
        source = PointSource(distance_um=view.distance_um)
        response = field.solid_angle() * field.vignetting()
        return {
            "psf": view.experiment(twin).psf(source, twin.psf_shape(support)).numpy(),
            "response": (response / response.max()).float()[None].numpy(),
            "support": (support.height, support.width, support.top, support.left),
            "sensor": twin.shape,
            "pixel_um": twin.pixel_um,
        }


def _decoded(data: bytes, name: str) -> Tensor:
    """Radiance of a picture, from the contents of its file."""
    with tempfile.NamedTemporaryFile(suffix=Path(name).suffix) as file:
        file.write(data)
        file.flush()
        try:
            picture = read_picture(file.name)
        except NolensError as error:
            raise type(error)(str(error).replace(file.name, name)) from None
    return picture.radiance if picture.opacity is None else picture.radiance * picture.opacity


@job
def make_dataset(run: Run[DatasetOptions]) -> Product[Path]:
    """Make what is missing of a data set, and its card when all is there.

    Raises
    ------
    NolensError
        If an option, a camera, a picture or the folder cannot be used.
    """
    options, folder = run.options, run.options.output
    check_layout(options.layout)
    if folder.is_dir() and any(folder.iterdir()):
        _check_continued(options)
    recipe = Recipe(run)
    work = DatasetWork(
        recipe.views, options.seed, options.luminance.cd_m2, options.measurement == "developed"
    )
    if options.items is not None:
        return _single_items(run, recipe, work)
    views = {recipe.views.name(number): number for number in range(len(recipe.views))}
    with closing(Manifest.open(folder, recipe.identity, [*views, *recipe.shards])) as manifest:
        failed = _make_missing(run, recipe, work, views, manifest)
        rows = manifest.rows("done")
        missing = sum(name not in rows for name in recipe.shards)
    figures: dict[str, Any] = {
        "count": options.count,
        "shards": len(recipe.shards),
        "missing_shards": missing,
        "failed": failed,
        "bytes": sum(row.get("bytes", 0) for row in rows.values()),
    }
    if missing:
        return Product(folder, figures, outputs=(folder,))
    description = _description(recipe, rows)
    figures["splits"] = {name: each.items for name, each in description.splits.items()}
    texts = {
        DATASET_FILE: description.json_text(),
        CARD_FILE: card_text(description),
        RECIPE_FILE: recipe.toml(),
    }
    writers = {folder / name: partial(write_text, text=text) for name, text in texts.items()}
    return Product(folder, figures, writers)


def _check_continued(options: DatasetOptions) -> None:
    """Refuse a folder with files in it that this command would not go on with."""
    begun = (options.output / MANIFEST_FILE).is_file()
    if options.items is not None and begun:
        raise OptionError(
            f"{options.output} is a data set, and --items writes files of single items: give "
            "another folder (-o)"
        )
    if options.items is None and not begun:
        raise OptionError(
            f"{options.output} has files, and no {MANIFEST_FILE} of a data set that was begun: "
            "give an empty folder (-o)"
        )


def _make_missing(
    run: Run[DatasetOptions],
    recipe: Recipe,
    work: DatasetWork,
    views: dict[str, int],
    manifest: Manifest,
) -> list[str]:
    """Make PSFs and shards that are not there; why some failed."""
    options, missing = run.options, manifest.missing
    shard_of = {
        index: name for name in missing if name in recipe.shards for index in recipe.shards[name][1]
    }
    run.begin()
    check_scheduler(options.scheduler)
    if not missing:
        return []
    workers = _workers(recipe)
    if len(shard_of) > _WORTH_A_WORD:
        _announce(run, recipe, work, list(shard_of), workers)

    def loads() -> Iterator[tuple[str, Callable[[], Any]]]:
        for name in missing:
            if name in views:
                yield name, partial(int, views[name])
                continue
            # Items of one camera follow each other, whose PSFs are computed once.
            by_view = sorted(recipe.shards[name][1], key=lambda each: recipe.settings(each).view)
            for index in by_view:
                yield str(index), partial(recipe.load, index)

    made: dict[str, dict[int, Row]] = {}
    failed: dict[str, str] = {}
    done = 0
    with closing(
        run_items(
            loads(), work, workers=workers, scheduler=options.scheduler, note=run.reporter.note
        )
    ) as outcomes:
        for outcome in outcomes:
            if outcome.key in views:
                if outcome.error:
                    raise DataError(f"{outcome.key} cannot be computed: {outcome.error}")
                _keep_psf(recipe, manifest, outcome.key, outcome.value)
                continue
            index, done = int(outcome.key), done + 1
            name = shard_of[index]
            if outcome.error:
                reason = f"item {index}: {outcome.error}"
                run.warn(f"{reason}; {name} is not written")
                manifest.fail(name, reason, outcome.attempts)
                failed[name] = reason
                made.pop(name, None)
            elif name not in failed:
                rows = made.setdefault(name, {})
                rows[index] = recipe.row(index, outcome.value)
                if len(rows) == len(recipe.shards[name][1]):
                    _keep_shard(recipe, manifest, name, made.pop(name))
            if run.reporter.step("item", done, len(shard_of), "the finished shards"):
                break
    return list(failed.values())


def _workers(recipe: Recipe) -> int:
    """Processes of this machine, as stated or as many as there is room for."""
    options = recipe.options
    if options.scheduler is not None:
        return 0
    return options.workers or worker_count(recipe.worker_bytes)


def _announce(
    run: Run[DatasetOptions], recipe: Recipe, work: DatasetWork, items: list[int], workers: int
) -> None:
    """Say how long it takes and how large it becomes, by a few items."""
    seconds, size = [], 0
    with one_thread():
        call = work.prepare()
        # Most often they are of one camera, whose PSFs are computed for the first.
        for index in items[:_TIMED]:
            begin = time.perf_counter()
            item = call(recipe.load(index))
            seconds.append(time.perf_counter() - begin)
            size += len(item["measurement"]) + len(item["truth"])
    each_s, total = min(seconds), size / len(seconds) * len(items)
    # Every worker computes the PSFs of every camera once, and one of them those that are stored.
    psfs_s = 2 * (max(seconds) - each_s) * len(recipe.views)
    by = f"{workers} workers" if workers > 1 else "one worker"
    time_text = duration_text(each_s * len(items) / max(1, workers) + psfs_s)
    run.reporter.note(f"{len(items)} items: about {time_text} by {by}, and {size_text(total)}")
    free = psutil.disk_usage(str(recipe.options.output)).free
    if free < total:
        run.warn(
            f"there are {size_text(free)} free in {recipe.options.output}: what is written stays "
            "when the disk is full, and the same command goes on when there is room"
        )


def _keep_psf(recipe: Recipe, manifest: Manifest, name: str, made: dict[str, Any]) -> None:
    psf, response = (recipe.options.output / file for file in _psf_files(name))
    writers: dict[Path, Writer] = {
        psf: partial(write_tiff32, radiance=torch.from_numpy(made["psf"]), sensor=made["sensor"]),
        response: partial(write_tiff32, radiance=torch.from_numpy(made["response"])),
    }
    manifest.keep(name, {key: made[key] for key in ("support", "pixel_um")}, writers)


def _psf_files(name: str) -> tuple[str, str]:
    """Of a PSF and of the response that belongs to it, in the folder."""
    return f"psfs/{name}.tif", f"psfs/{name}-response.tif"


def _keep_shard(recipe: Recipe, manifest: Manifest, name: str, rows: dict[int, Row]) -> None:
    options = recipe.options
    in_order = [rows[index] for index in recipe.shards[name][1]]
    data = shard_bytes(options.layout, in_order, options.measurement == "developed")
    about = {"sha256": hashlib.sha256(data).hexdigest(), "bytes": len(data)}
    manifest.keep(name, about, {options.output / name: partial(Path.write_bytes, data=data)})


def _description(recipe: Recipe, rows: dict[str, dict[str, Any]]) -> DatasetDescription:
    """What is said of a finished data set; `rows` are those of its manifest."""
    options, views = recipe.options, recipe.views
    psfs = {}
    for number in range(len(views)):
        name, (camera, mask, _) = views.name(number), views.parts(number)
        sensor = views.cameras[camera].loaded.camera.sensor
        file, response = _psf_files(name)
        psfs[name] = DatasetPsf(
            camera=camera,
            mask=mask,
            distance=views.distance(number),
            file=file,
            response=response,
            sha256=InputFile.of(options.output / file).sha256,
            support=rows[name]["support"],
            mosaic=None if sensor.mosaic == "none" else sensor.mosaic,
            pixel_um=rows[name]["pixel_um"],
        )
    splits: dict[Any, DatasetSplit] = {}
    for split in SPLITS:
        shards = {name: items for name, (each, items) in recipe.shards.items() if each == split}
        numbers = [index for items in shards.values() for index in items]
        splits[split] = DatasetSplit(
            items=len(numbers),
            scenes=len({recipe.scene(index) for index in numbers}),
            shards=tuple(
                DatasetShard(file=name, items=len(items), sha256=rows[name]["sha256"])
                for name, items in shards.items()
            ),
        )
    return DatasetDescription(
        nolens=version("nolens"),
        layout=options.layout,
        measurement=options.measurement,
        licence=options.licence,
        recipe=recipe.values,
        scenes=len(recipe.scenes.names),
        scenes_sha256=recipe.scenes.sha256,
        cameras=recipe.cameras,
        psfs=psfs,
        splits=splits,
    )


def _single_items(run: Run[DatasetOptions], recipe: Recipe, work: DatasetWork) -> Product[Path]:
    """Items as files of their own: two pictures and JSON for each."""
    options, numbers = run.options, run.options.numbers
    beyond = next((each for each in numbers if each >= options.count), None)
    if beyond is not None or not numbers:
        raise OptionError(
            f"--items {options.items} has {'none' if beyond is None else beyond}: there are the "
            f"items 0 to {options.count - 1}"
        )
    run.begin()
    check_scheduler(options.scheduler)
    workers = min(len(numbers), _workers(recipe))
    loads = ((str(each), partial(recipe.load, each)) for each in numbers)
    outcomes = run_items(loads, work, workers=workers, scheduler=options.scheduler)
    with closing(outcomes):
        for outcome in outcomes:
            if outcome.error:
                raise DataError(f"item {outcome.key}: {outcome.error}")
            row = recipe.row(int(outcome.key), outcome.value)
            stem = options.output / f"{row['index']:08d}"
            pictures = {key: row.pop(key) for key in ("measurement", "truth")}
            writers: dict[Path, Writer] = {
                stem.with_suffix(f".{key}.png"): partial(Path.write_bytes, data=data)
                for key, data in pictures.items()
            }
            text = json.dumps(row, indent=2, ensure_ascii=False) + "\n"
            writers[stem.with_suffix(".json")] = partial(write_text, text=text)
            write_into(options.output, writers)
    return Product(options.output, {"count": len(numbers)}, outputs=(options.output,))
