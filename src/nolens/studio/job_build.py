"""From what the page asks for to a job that is ready to run: its options and where it writes."""

import importlib
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

from nolens.design.preview import with_thickness
from nolens.errors import FileError, OptionError
from nolens.files import CAMERA_FILE, atomic_write, is_sequence, read_camera, write_into
from nolens.files.cameras import camera_copies, write_description
from nolens.files.plots import dark_plots
from nolens.jobs.designing.look import Thicknesses
from nolens.jobs.options import JobOptions, Option
from nolens.jobs.run import Reporter
from nolens.studio.job_kinds import KINDS
from nolens.studio.schemas import JobKind
from nolens.studio.workspace import CAMERAS, JOBS, PICTURES, SHOTS, unused

_NAME = "letters, digits, spaces and any of - _ ( ), at most 60, such as bench-camera"


@dataclass(frozen=True)
class Place:
    """Where a job writes.

    Parameters
    ----------
    work
        Folder of the workspace.
    id
        Of the job.
    """

    work: Path
    id: str

    @property
    def folder(self) -> Path:
        """The job's own."""
        return self.work / JOBS / self.id


@dataclass(frozen=True)
class Ready:
    """A job whose options were read.

    Parameters
    ----------
    folder
        That must exist for it.
    run
        Does it, and gives its summary.
    """

    folder: Path
    run: Callable[[Reporter], dict[str, Any]]

    def make_folder(self) -> None:
        """Make its folder.

        Raises
        ------
        FileError
            If it cannot be made.
        """
        try:
            self.folder.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise FileError(f"cannot make {self.folder}: {error.strerror or error}") from None


def build(kind: JobKind, given: Mapping[str, Any], place: Place) -> Ready:
    """Read the options of a job as its command does.

    Parameters
    ----------
    kind
        Of the job.
    given
        Options by name, with real paths.
    place
        Where it writes.

    Raises
    ------
    NolensError
        If an option cannot be used.
    """
    about = KINDS[kind]
    model: type[JobOptions] = _named(about.options)
    options = {name: value for name, value in given.items() if name not in about.own}
    own = {name: value for name, value in given.items() if name in about.own}
    for name in options:
        if name not in model.spellings():
            known = [each for each in model.model_fields if each not in about.chosen]
            raise OptionError(
                f"there is no option {name!r} of {kind}; known are {', '.join(known)}"
            )
    _check_texts(options)
    changed = Thicknesses.gather({"thickness": own["thickness"]}) if "thickness" in own else None
    folder, chosen = _CHOSEN[kind](options, own, place)
    read = model.gather({**options, **chosen})

    def run(reporter: Reporter) -> dict[str, Any]:
        ready = read
        if changed is not None:
            camera = _changed_camera(options["camera"], changed, place)
            ready = model.gather({**options, **chosen, "camera": camera})
        with dark_plots() as dark:
            summary = dict(_named(about.run)(ready, reporter).summary)
        if dark and "plot" in chosen:
            path = chosen["plot"].with_suffix(".dark.png")
            with atomic_write(path) as temporary:
                temporary.write_bytes(dark[-1])
            summary["outputs"] = [*summary.get("outputs", []), str(path)]
        return summary

    return Ready(folder, run)


def declarations() -> dict[JobKind, dict[str, dict[str, str]]]:
    """The options of every kind of job: what the page calls each, its help, and what it names."""
    found: dict[JobKind, dict[str, dict[str, str]]] = {}
    for kind, about in KINDS.items():
        model: type[JobOptions] = _named(about.options)
        options = {name: Option.of(model, field) for name, field in model.spellings().items()}
        found[kind] = {
            name: {"label": each.label, "help": each.help, "role": each.role}
            for name, each in options.items()
        } | {
            name: {"label": label, "help": "", "role": "value"} for name, label in about.own.items()
        }
    return found


def _named(path: str) -> Any:
    module, name = path.split(":")
    return getattr(importlib.import_module(module), name)


def _check_texts(options: Mapping[str, Any]) -> None:
    """Refuse text that no option takes, and that the system would stumble over."""
    for name, value in options.items():
        for each in value if isinstance(value, list) else [value]:
            if isinstance(each, str) and "\0" in each:
                raise OptionError(f"{name} is {each!r}: no option has such a character")


_Chosen = tuple[Path, dict[str, Any]]


def _picture(options: Mapping[str, Any], own: Mapping[str, Any], place: Place) -> _Chosen:
    folder = place.work / PICTURES
    measurement = Path(str(options.get("measurement", "picture")))
    stem = unused(folder, measurement.stem or "picture")
    if is_sequence(measurement):
        return folder, {"output": (folder / stem,)}
    return folder, {"output": (folder / f"{stem}.png", folder / f"{stem}.tif")}


def _refocused(options: Mapping[str, Any], own: Mapping[str, Any], place: Place) -> _Chosen:
    folder = place.work / PICTURES
    stem = Path(str(options.get("measurement", "picture"))).stem
    return folder, {"output": folder / unused(folder, f"{stem}-refocus")}


def _shot(options: Mapping[str, Any], own: Mapping[str, Any], place: Place) -> _Chosen:
    folder = place.work / SHOTS
    scenes = options.get("scenes")
    first = Path(scenes[0] if isinstance(scenes, list) and scenes else str(scenes))
    camera = read_camera(str(options.get("camera", "paper"))).camera
    suffix = ".tif" if camera.sensor.mosaic == "none" else ".dng"
    return folder, {"output": folder / f"{unused(folder, f'{first.stem}-simulated')}{suffix}"}


def _in_camera(options: Mapping[str, Any], own: Mapping[str, Any], place: Place) -> _Chosen:
    name = own.get("name", "camera")
    allowed = isinstance(name, str) and 0 < len(name) <= 60 and name.strip() == name
    if not allowed or not all(each.isalnum() or each in "-_ ()" for each in name):
        raise OptionError(f"name is {name!r}: give {_NAME}")
    return place.work / CAMERAS, {"output": place.work / CAMERAS / name}


def _thickness(options: Mapping[str, Any], own: Mapping[str, Any], place: Place) -> _Chosen:
    chosen: dict[str, Any] = {"plot": place.folder / "thickness.png"}
    if "name" in own:
        chosen |= _in_camera(options, own, place)[1]
    return place.folder, chosen


def _field(options: Mapping[str, Any], own: Mapping[str, Any], place: Place) -> _Chosen:
    chosen = {"plot": place.folder / "field.png"}
    if options.get("simulate") and options.get("dot_pitch"):
        chosen["output"] = place.folder / "dots.png"
    return place.folder, chosen


def _in_job(option: str, name: str) -> Callable[..., _Chosen]:
    def choose(options: Mapping[str, Any], own: Mapping[str, Any], place: Place) -> _Chosen:
        return place.folder, {option: place.folder / name}

    return choose


_CHOSEN: dict[JobKind, Callable[..., _Chosen]] = {
    "reconstruct": _picture,
    "refocus": _refocused,
    "simulate": _shot,
    "psf": _in_job("output", "psf.tif"),
    "calibrate": _in_camera,
    "design-thickness": _thickness,
    "design-look": _in_job("output", "psf.png"),
    "fabricate": _in_job("output", "workshop"),
    "measure-psf": _in_job("plot", "psf.png"),
    "measure-two-points": _in_job("plot", "two-points.png"),
    "measure-siemens": _in_job("plot", "star.png"),
    "measure-edge": _in_job("plot", "edge.png"),
    "measure-field": _field,
    "preview": _in_job("output", "preview.png"),
}


def _changed_camera(name: str, changed: Thicknesses, place: Place) -> str:
    """Folder of a camera like another one, but for the thickness of layers."""
    opened = read_camera(name)
    camera = with_thickness(opened, changed.thickness).camera
    folder = place.folder / "camera"
    writers = camera_copies(name, opened) | {CAMERA_FILE: partial(write_description, camera=camera)}
    write_into(folder, {folder / file: write for file, write in writers.items()})
    return str(folder)
