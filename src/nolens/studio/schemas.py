"""What the page and the server tell each other, as models: they make the OpenAPI document."""

from typing import Annotated, Any, Literal

from pydantic import AliasChoices, BaseModel, ConfigDict, Field

Method = Literal["wiener", "admm"]
EntryKind = Literal["folder", "raw", "picture", "camera", "record", "other"]
Status = Literal["queued", "running", "done", "failed", "cancelled"]
JobKind = Literal[
    "reconstruct",
    "refocus",
    "simulate",
    "psf",
    "calibrate",
    "calibrate-import",
    "design-thickness",
    "design-look",
    "fabricate",
    "measure-psf",
    "measure-two-points",
    "measure-siemens",
    "measure-edge",
    "measure-field",
    "preview",
]
SCENES = {
    "chart": "Chart",
    "astronaut": "Astronaut",
    "coffee": "Coffee",
    "camera": "Cameraman",
    "point": "Point source",
    "dark": "No light",
}
"""Built-in scenes by id, and what the page calls them."""
ENDED: tuple[Status, ...] = ("done", "failed", "cancelled")


class _PageRequest(BaseModel):
    """What the page sends: without unknown names."""

    model_config = ConfigDict(extra="forbid", allow_inf_nan=False)


class Trouble(BaseModel):
    """What went wrong, for a person."""

    detail: str


class Folder(BaseModel):
    """A folder that a person named."""

    id: str
    path: str
    writable: bool


class PsfInfo(BaseModel):
    """A PSF in a camera's folder."""

    path: str
    distance: str
    angle: list[str]


class CameraInfo(BaseModel):
    """A camera: a preset, or a folder with its description or PSFs; `trouble` is why it is bad."""

    id: str
    name: str
    note: str
    psfs: list[PsfInfo]
    trouble: str | None = None


class SourceInfo(BaseModel):
    """Something that frames come from."""

    id: str
    label: str
    available: bool
    why: str
    asks: str


class SceneInfo(BaseModel):
    """A scene that the twin can be shown."""

    id: str
    label: str


class About(BaseModel):
    """What there is to work with."""

    version: str
    folders: list[Folder]
    cameras: list[CameraInfo]
    sources: list[SourceInfo]
    scenes: list[SceneInfo]
    upload_bytes: int
    kinds: list[str]


class Entry(BaseModel):
    """A file or folder; `changed` in seconds since 1970."""

    name: str
    path: str
    kind: EntryKind
    bytes: int
    changed: float


class Entries(BaseModel):
    """What lies in a folder."""

    entries: list[Entry]


class Record(BaseModel):
    """The record of a run; paths in it that lie in a named folder are the page's."""

    record: dict[str, Any]


class BatchProgress(BaseModel):
    """How far a batch is: items by state, and why the first of those that failed did."""

    counts: dict[str, int]
    failed: dict[str, str]


class Uploaded(BaseModel):
    """Where an upload was put."""

    path: str


class Settings(BaseModel):
    """How the live view is exposed and reconstructed: the automatic τ is divided by the detail; a
    trained prior is used where it keeps ten frames a second, or none; of PSFs over the field the
    mean is used, or all; no exposure time means automatic.
    """

    method: Method = "admm"
    detail: float = 1.0
    iterations: int = 2
    trained: bool = True
    over_field: bool = False
    exposure_s: float | None = None
    gain: float = 1.0
    frozen: bool = False


class SettingsChange(_PageRequest):
    """Some settings; what is left out stays."""

    method: Method | None = None
    detail: Annotated[float, Field(ge=0.125, le=8)] | None = None
    iterations: Annotated[int, Field(ge=1, le=40)] | None = None
    trained: bool | None = None
    over_field: bool | None = None
    exposure_s: Annotated[float, Field(gt=0, le=1000)] | None = None
    gain: Annotated[float, Field(gt=0, le=1000)] | None = None
    frozen: bool | None = None


class LiveLimits(BaseModel):
    """What the camera can be set to."""

    exposure_s: tuple[float, float]
    gain: tuple[float, float]


class CameraName(BaseModel):
    """The camera that frames come from; its id is the `camera` option of jobs, where it has one."""

    id: str | None
    name: str


class LiveState(BaseModel):
    """How the live view is."""

    running: bool = False
    source: str | None = None
    camera: CameraName | None = None
    settings: Settings = Field(default_factory=Settings)
    error: str | None = None
    fps: float = 0.0
    dropped: int = 0
    psf_path: str | None = None
    field_points: int = 1
    limits: LiveLimits | None = None
    scene: str | None = None


class LiveStart(_PageRequest):
    """Which source to look through; a PSF where the source brings none."""

    source: Annotated[str, Field(max_length=1000)]
    psf: Annotated[str, Field(max_length=1000)] | None = None
    settings: SettingsChange | None = None


class LivePixel(BaseModel):
    """A pixel of the frame that is displayed: counts of the sensor, or radiance."""

    x: int
    y: int
    unit: Literal["counts", "radiance"]
    values: dict[str, float]


class BuiltinScene(_PageRequest):
    """One of the scenes that the studio brings."""

    builtin: Annotated[str, Field(max_length=100)]


class SceneAnswer(BaseModel):
    """What the twin sees now."""

    scene: str


class SaveRequest(_PageRequest):
    """What to write of the frame that is shown, and into which folder; the record is always
    written.
    """

    folder: Literal["shots", "calibration"] = "shots"
    model_config = ConfigDict(extra="forbid", populate_by_name=True)

    formats: Annotated[
        list[Literal["png", "tiff", "raw"]], Field(alias="as", min_length=1, max_length=3)
    ] = [
        "png",
        "tiff",
        "raw",
    ]


class Saved(BaseModel):
    """Files that were written, and the PSF that belongs to the raw frame."""

    files: list[str]
    psf_path: str | None = None


class JobRequest(_PageRequest):
    """A command and its options, by the names that the command line has."""

    kind: JobKind
    options: dict[str, Any] = Field(default_factory=dict)


class JobOption(BaseModel):
    """An option of a job, as the job declares it: `default` is the text for what is taken where it
    is left out, `choices` are its values where it has only a few; those that most people need have
    no `group`.
    """

    label: str
    help: str
    role: Literal["value", "input", "output", "camera", "material"]
    group: str = ""
    default: str = ""
    choices: list[str] = Field(default_factory=list)


class JobDeclarations(BaseModel):
    """The options of every kind of job, by name."""

    kinds: dict[JobKind, dict[str, JobOption]]


class JobId(BaseModel):
    """The name of a new job."""

    id: str


class JobProgress(BaseModel):
    """How far a job is; ``share`` is the fraction in jobs of the version before."""

    what: str
    fraction: float = Field(validation_alias=AliasChoices("fraction", "share"))
    done: int | None = None
    limit: int | None = None
    seconds_left: float | None = None


class JobShort(BaseModel):
    """A job in a list; `outputs` are paths of files, times are seconds since 1970."""

    id: str
    kind: str
    title: str
    status: Status
    progress: JobProgress | None = None
    error: str | None = None
    outputs: list[str] = Field(default_factory=list)
    started: float | None = None
    ended: float | None = None


class Job(JobShort):
    """All that is known of a job."""

    history: list[dict[str, float | None]] = Field(default_factory=list)
    notes: list[str] = Field(default_factory=list)
    warnings: list[str] = Field(default_factory=list)
    summary: dict[str, Any] | None = None
    options: dict[str, Any] = Field(default_factory=dict)


class Jobs(BaseModel):
    """All jobs, the newest first."""

    jobs: list[JobShort]
