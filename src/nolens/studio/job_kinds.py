"""The kinds of jobs: which command each is, and the page's paths among its options."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any

from nolens.errors import OptionError
from nolens.studio.schemas import JobKind, JobOption
from nolens.studio.workspace import Workspace


@dataclass(frozen=True)
class Kind:
    """A command as the page can start it.

    Parameters
    ----------
    title
        What it does, for people; the name of what it works on follows.
    options, run
        Class of its options and its function, as ``"module:name"`` (they load the numerics).
    about
        Options that name what it works on, the first that is given counts.
    chosen
        Options that the studio chooses: what is written, and where.
    own
        Options of the studio's, beside those of the command, with what the page calls them.
    brief
        Whether it answers a person who waits: it goes before others, and is not kept for long.
    """

    title: str
    options: str
    run: str
    about: tuple[str, ...]
    chosen: tuple[str, ...] = ("output",)
    own: Mapping[str, str] = field(default_factory=dict)
    brief: bool = False


_JOBS = "nolens.jobs"
_MOST_FILES = 2000
KINDS: dict[JobKind, Kind] = {
    "reconstruct": Kind(
        "Reconstruct",
        f"{_JOBS}.reconstruction.options:ReconstructOptions",
        f"{_JOBS}.reconstruction.job:reconstruct",
        about=("measurement",),
    ),
    "refocus": Kind(
        "Refocus",
        f"{_JOBS}.refocusing:RefocusOptions",
        f"{_JOBS}.refocusing:refocus",
        about=("measurement",),
    ),
    "simulate": Kind(
        "Simulate",
        f"{_JOBS}.simulation:SimulateOptions",
        f"{_JOBS}.simulation:simulate",
        about=("scenes",),
        chosen=("output", "truth", "response"),
    ),
    "psf": Kind(
        "PSF of",
        f"{_JOBS}.psf:PsfOptions",
        f"{_JOBS}.psf:simulate_psf",
        about=("camera",),
    ),
    "calibrate": Kind(
        "Calibrate",
        f"{_JOBS}.calibration.point:CalibratePointOptions",
        f"{_JOBS}.calibration.point:calibrate_point",
        about=("name", "frames"),
        own={"name": "Folder of its PSFs"},
    ),
    "design-thickness": Kind(
        "Thickness for",
        f"{_JOBS}.designing.thickness:ThicknessOptions",
        f"{_JOBS}.designing.thickness:design_thickness",
        about=("camera", "material"),
        chosen=("output", "plot"),
        own={"name": "Name"},
    ),
    "design-look": Kind(
        "Look at",
        f"{_JOBS}.designing.look:LookOptions",
        f"{_JOBS}.designing.look:look_at_design",
        about=("camera",),
        brief=True,
    ),
    "fabricate": Kind(
        "Fabricate",
        f"{_JOBS}.fabrication:FabricateOptions",
        f"{_JOBS}.fabrication:fabricate",
        about=("camera",),
        own={"thickness": "Layers"},
    ),
    "measure-psf": Kind(
        "Measure",
        f"{_JOBS}.measuring.psf:MeasurePsfOptions",
        f"{_JOBS}.measuring.psf:measure_psf",
        about=("psf",),
        chosen=("plot",),
    ),
    "measure-two-points": Kind(
        "Two points by",
        f"{_JOBS}.measuring.two_points:TwoPointOptions",
        f"{_JOBS}.measuring.two_points:measure_two_points",
        about=("simulate", "frames"),
        chosen=("plot",),
    ),
    "measure-siemens": Kind(
        "Star by",
        f"{_JOBS}.measuring.siemens:SiemensOptions",
        f"{_JOBS}.measuring.siemens:measure_siemens",
        about=("simulate", "frames"),
        chosen=("plot",),
    ),
    "measure-edge": Kind(
        "Edge by",
        f"{_JOBS}.measuring.edge:EdgeOptions",
        f"{_JOBS}.measuring.edge:measure_edge",
        about=("simulate", "frames"),
        chosen=("plot",),
    ),
    "measure-field": Kind(
        "Field of view of",
        f"{_JOBS}.measuring.field:MeasureFieldOptions",
        f"{_JOBS}.measuring.field:measure_field",
        about=("simulate", "psfs", "dots"),
        chosen=("plot", "output"),
    ),
    "preview": Kind(
        "Preview",
        f"{_JOBS}.preview:PreviewOptions",
        f"{_JOBS}.preview:preview",
        about=("path",),
        brief=True,
    ),
}


def title_of(kind: JobKind, given: Mapping[str, Any]) -> str:
    """What a job is called, such as "Reconstruct raw.dng"."""
    about = next((given[name] for name in KINDS[kind].about if given.get(name)), None)
    count = len(about) if isinstance(about, list) else 1
    first = about[0] if isinstance(about, list) else about
    if not isinstance(first, str):
        return KINDS[kind].title.removesuffix(" of").removesuffix(" for").removesuffix(" by")
    more = f" and {count - 1} more" if count > 1 else ""
    return f"{KINDS[kind].title} {first.rstrip('/').rsplit('/', 1)[-1][:100]}{more}"


def with_paths(
    kind: JobKind,
    declared: Mapping[str, JobOption],
    given: Mapping[str, Any],
    workspace: Workspace,
) -> dict[str, Any]:
    """Options with real paths in place of the page's, each checked to lie in a named folder.

    Parameters
    ----------
    kind
        Of the job.
    declared
        Its options.
    given
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
    about = KINDS[kind]
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
        is_file = "/" in text or text.lower().endswith(".toml")
        return str(workspace.resolve(text)) if is_file else text

    change: dict[str, Callable[[str], str]] = {
        "input": lambda text: str(workspace.resolve(text)),
        "camera": camera,
        "material": material,
    }
    found: dict[str, Any] = {}
    for name, value in given.items():
        if value is None:
            continue
        if name in about.chosen or name == "record":
            raise OptionError(f"{name} is chosen by the studio: leave it out")
        role = declared[name].role if name in declared else "value"
        found[name] = _each(name, value, change[role]) if role in change else value
    return found


def _each(name: str, value: Any, change: Callable[[str], str]) -> Any:
    """A text, or all texts of a list, changed."""
    if isinstance(value, str):
        return change(value)
    if isinstance(value, list) and len(value) > _MOST_FILES:
        raise OptionError(f"{name} names {len(value)} files: give at most {_MOST_FILES}")
    if isinstance(value, list) and all(isinstance(each, str) for each in value):
        return [change(each) for each in value]
    raise OptionError(f"{name} is {str(value)[:80]}: give a path, or a list of them")
