"""The kinds of jobs that the page can start: which job of `nolens.jobs` each is, its title, and
where it writes.

The server loads this file, so what loads the numerics is imported in the functions that use it.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from nolens.errors import OptionError
from nolens.studio.schemas import JobKind, JobOption
from nolens.studio.workspace import CAMERAS, JOBS, PICTURES, SHOTS, Workspace, unused

_MOST_FILES = 2000
_NAME = "letters, digits, spaces and any of - _ ( ), at most 60, such as bench-camera"
Outputs = dict[str, Path | tuple[Path, ...]]
"""Options that the studio chooses, with the files or folders that they name."""


@dataclass(frozen=True)
class Place:
    """Where a job writes: the folder of the workspace, and the id of the job."""

    work: Path
    id: str

    @property
    def folder(self) -> Path:
        """The job's own."""
        return self.work / JOBS / self.id


@dataclass(frozen=True)
class Kind:
    """A job as the page can start it.

    Parameters
    ----------
    title
        What it does, for people; the name of what it works on follows.
    job
        Its name in `nolens.jobs`.
    about
        Options that name what it works on, the first that has a value counts.
    outputs
        Chooses its outputs by its options; the first one's folder is made for it.
    own
        Options of the studio's, beside those of the job, with what the page calls them.
    brief
        Whether it answers a person who waits: it goes before others, and is not kept for long.
    """

    title: str
    job: str
    about: tuple[str, ...]
    outputs: Callable[[Mapping[str, Any], Place], Outputs]
    own: Mapping[str, str] = field(default_factory=dict)
    brief: bool = False


def _in_job(option: str, name: str) -> Callable[[Mapping[str, Any], Place], Outputs]:
    """An output with a fixed name in the job's own folder."""
    return lambda options, place: {option: place.folder / name}


def _picture(options: Mapping[str, Any], place: Place) -> Outputs:
    from nolens.files import is_sequence
    from nolens.files.video import has_video_support

    folder, measurement = place.work / PICTURES, _measurement(options)
    stem = unused(folder, measurement.stem or "picture")
    if options.get("depths") or options.get("bands"):
        return {"output": (folder / stem,)}
    if options.get("frames"):
        suffixes = (".png", ".tif", *([".mp4"] if has_video_support() else []))
        return {"output": tuple(folder / f"{stem}{suffix}" for suffix in suffixes)}
    if is_sequence(measurement):
        return {"output": (folder / stem,)}
    return {"output": (folder / f"{stem}.png", folder / f"{stem}.tif")}


def _refocused(options: Mapping[str, Any], place: Place) -> Outputs:
    folder = place.work / PICTURES
    return {"output": folder / unused(folder, f"{_measurement(options).stem}-refocus")}


def _psf(options: Mapping[str, Any], place: Place) -> Outputs:
    """A file, or a camera's folder of PSFs over the field."""
    several = options.get("field_points", 1) != 1
    return {"output": place.folder / ("camera" if several else "psf.tif")}


def _measurement(options: Mapping[str, Any]) -> Path:
    return Path(str(options.get("measurement", "picture")))


def _shot(options: Mapping[str, Any], place: Place) -> Outputs:
    from nolens.files import read_camera

    folder, scenes = place.work / SHOTS, options.get("scenes")
    first = Path(scenes[0] if isinstance(scenes, list) and scenes else str(scenes))
    camera = read_camera(str(options.get("camera", "paper"))).camera
    suffix = ".tif" if camera.sensor.mosaic == "none" else ".dng"
    return {"output": folder / f"{unused(folder, f'{first.stem}-simulated')}{suffix}"}


def _camera(options: Mapping[str, Any], place: Place) -> Outputs:
    name = options.get("name", "camera")
    allowed = isinstance(name, str) and 0 < len(name) <= 60 and name.strip() == name
    if not allowed or not all(each.isalnum() or each in "-_ ()" for each in name):
        raise OptionError(f"name is {name!r}: give {_NAME}")
    return {"output": place.work / CAMERAS / name}


def _thickness(options: Mapping[str, Any], place: Place) -> Outputs:
    camera = _camera(options, place) if "name" in options else {}
    return {"plot": place.folder / "thickness.png", **camera}


def _field(options: Mapping[str, Any], place: Place) -> Outputs:
    simulated = options.get("simulate") and options.get("dot_pitch")
    dots: Outputs = {"output": place.folder / "dots.png"} if simulated else {}
    return {"plot": place.folder / "field.png", **dots}


_CAMERA = ("camera",)
_MEASUREMENT = ("measurement",)
_FRAMES = ("simulate", "frames")
KINDS: dict[JobKind, Kind] = {
    "reconstruct": Kind("Reconstruct", "reconstruct", _MEASUREMENT, _picture),
    "refocus": Kind("Refocus", "refocus", _MEASUREMENT, _refocused),
    "simulate": Kind("Simulate", "simulate", ("scenes",), _shot),
    "psf": Kind("PSF of", "simulate_psf", _CAMERA, _psf),
    "calibrate": Kind(
        "Calibrate",
        "calibrate_point",
        ("name", "frames"),
        _camera,
        own={"name": "Folder of its PSFs"},
    ),
    "calibrate-import": Kind(
        "Import",
        "calibrate_import",
        ("name", "psfs"),
        _camera,
        own={"name": "Folder of its PSFs"},
    ),
    "design-thickness": Kind(
        "Thickness for",
        "design_thickness",
        ("camera", "material"),
        _thickness,
        own={"name": "Name"},
    ),
    "design-look": Kind(
        "Look at", "look_at_design", _CAMERA, _in_job("output", "psf.png"), brief=True
    ),
    "fabricate": Kind(
        "Fabricate",
        "fabricate",
        _CAMERA,
        _in_job("output", "workshop"),
        own={"thickness": "Layers"},
    ),
    "measure-psf": Kind("Measure", "measure_psf", ("psf",), _in_job("plot", "psf.png")),
    "measure-two-points": Kind(
        "Two points by", "measure_two_points", _FRAMES, _in_job("plot", "two-points.png")
    ),
    "measure-siemens": Kind("Star by", "measure_siemens", _FRAMES, _in_job("plot", "star.png")),
    "measure-edge": Kind("Edge by", "measure_edge", _FRAMES, _in_job("plot", "edge.png")),
    "measure-field": Kind(
        "Field of view of", "measure_field", ("simulate", "psfs", "dots"), _field
    ),
    "preview": Kind(
        "Preview", "write_preview", ("path",), _in_job("output", "preview.png"), brief=True
    ),
}


def title_of(kind: JobKind, options: Mapping[str, Any]) -> str:
    """What a job is called, such as "Reconstruct raw.dng"."""
    about = next((options[name] for name in KINDS[kind].about if options.get(name)), None)
    count = len(about) if isinstance(about, list) else 1
    first = about[0] if isinstance(about, list) else about
    if not isinstance(first, str):
        return KINDS[kind].title.removesuffix(" of").removesuffix(" for").removesuffix(" by")
    more = f" and {count - 1} more" if count > 1 else ""
    return f"{KINDS[kind].title} {first.rstrip('/').rsplit('/', 1)[-1][:100]}{more}"


def with_paths(
    declared: Mapping[str, JobOption],
    options: Mapping[str, Any],
    workspace: Workspace,
) -> dict[str, Any]:
    """Options with real paths in place of the page's, each checked to lie in a named folder.

    Parameters
    ----------
    declared
        Options of the job.
    options
        What the page asks for.
    workspace
        Folders that the page knows.

    Raises
    ------
    OptionError
        If a path is none, or the option is not the page's to choose.
    FileError
        If there is no such file.
    """
    presets = workspace.presets()

    def camera(text: str) -> str:
        if text in presets:
            return text
        if "/" not in text:
            raise OptionError(
                f"there is no camera {text!r}: give one of {', '.join(presets)}, or the path of a "
                "camera's folder such as work/cameras/mine"
            )
        return str(workspace.resolve(text))

    def material(text: str) -> str:
        is_file = "/" in text or text.lower().endswith((".toml", ".npz"))
        return str(workspace.resolve(text)) if is_file else text

    change: dict[str, Callable[[str], str]] = {
        "input": lambda text: str(workspace.resolve(text)),
        "camera": camera,
        "material": material,
    }
    resolved: dict[str, Any] = {}
    for name, value in options.items():
        if value is None:
            continue
        role = declared[name].role if name in declared else "value"
        if role == "output" or name == "record":
            raise OptionError(f"{name} is chosen by the studio: leave it out")
        resolved[name] = _each(name, value, change[role]) if role in change else value
    return resolved


def _each(name: str, value: Any, change: Callable[[str], str]) -> Any:
    """A text, or all texts of a list, changed."""
    if isinstance(value, str):
        return change(value)
    if isinstance(value, list) and len(value) > _MOST_FILES:
        raise OptionError(f"{name} names {len(value)} files: give at most {_MOST_FILES}")
    if isinstance(value, list) and all(isinstance(each, str) for each in value):
        return [change(each) for each in value]
    raise OptionError(f"{name} is {str(value)[:80]}: give a path, or a list of them")
