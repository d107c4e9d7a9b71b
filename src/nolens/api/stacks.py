"""Depths of a volume, bands of a spectrum or frames of a video, from one measurement."""

import math
import tempfile
from base64 import b64encode
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from html import escape
from pathlib import Path
from typing import Any, ClassVar, Literal

import numpy as np
from numpy.typing import NDArray
from torch import Tensor

from nolens.api.image import Image
from nolens.api.inputs import CallbackReporter, Progress, Raw, distance_um, frame_of, reported
from nolens.api.simulate import Camera, SimulatedMeasurement
from nolens.camera import Frame, LoadedCamera
from nolens.camera.psf_set import Depth
from nolens.files import CAMERA_FILE, check_folder, check_output, write_into
from nolens.files.atomic import Writer
from nolens.files.video import has_video_support
from nolens.jobs.reconstruction.bands import reconstruct_bands
from nolens.jobs.reconstruction.options import ReconstructOptions
from nolens.jobs.reconstruction.video import reconstruct_video as reconstruct_frames
from nolens.jobs.reconstruction.volume import reconstruct_volume as reconstruct_depths
from nolens.jobs.run import Product, Reporter, Run
from nolens.operators import PixelRectangle
from nolens.quantities import Angle, Length
from nolens.solvers import Progress as Iteration
from nolens.solvers.inputs import Support
from nolens.twin import Twin, check_simulation_memory

_BEFORE = 0.3
"""Fraction of the work that the choices of support and weight are."""
_UNWRITTEN = Path(tempfile.gettempdir()) / "nolens-notebook"
"""Names the files of a job in a notebook, which writes none."""


@dataclass(frozen=True, repr=False)
class Stack:
    """Scenes that were solved together; ``stack[k]`` is the picture of one, NumPy takes them all.

    Parameters
    ----------
    values
        Linear radiance, (scenes, channels, height, width); of bands (bands, height, width).
    channels
        Name of every channel of a picture.
    figures
        Of the run, as ``nolens reconstruct --json`` prints them: tau, iterations, stop_reason.
    notes, warnings
        What was done to the data, and what may make the scenes worse than they could be.
    writers
        What writes each file, by its name.
    """

    values: Tensor = field(repr=False)
    channels: tuple[str, ...]
    figures: dict[str, Any] = field(repr=False)
    notes: tuple[str, ...] = field(repr=False)
    warnings: tuple[str, ...] = field(repr=False)
    writers: Mapping[str, Writer] = field(repr=False)

    picture: ClassVar[str]
    """File that shows all of them."""

    def save(self, path: str | Path) -> Path:
        """Write the files that the command writes, into a folder.

        Raises
        ------
        FileError
            If they cannot be written.
        """
        folder = Path(path)
        check_folder(folder)
        write_into(folder, {folder / name: write for name, write in self.writers.items()})
        return folder

    def __len__(self) -> int:
        return len(self.values)

    def __getitem__(self, number: int) -> Image:
        return Image(self.values[number].reshape(-1, *self.values.shape[-2:]), self.channels)

    def __array__(self, dtype: Any = None, copy: bool | None = None) -> NDArray[Any]:
        return np.array(self.values, dtype=dtype, copy=copy)

    def _repr_png_(self) -> bytes:
        return self._written(self.picture)

    def __repr__(self) -> str:
        height, width = self.values.shape[-2:]
        return f"{type(self).__name__}({len(self)} of {height}×{width}, {', '.join(self.channels)})"

    def _written(self, name: str) -> bytes:
        with tempfile.TemporaryDirectory() as folder:
            path = Path(folder) / name
            self.writers[name](path)
            return path.read_bytes()


class Volume(Stack):
    """Planes at several depths; a notebook shows a page that turns them."""

    picture = "all-in-focus.png"

    @property
    def depths_mm(self) -> tuple[float, ...]:
        """The nearest first; the last may be infinite."""
        return tuple(float(each) for each in self.figures["depths_mm"])

    def _repr_html_(self) -> str:
        page = escape(self._written("volume.html").decode())
        return f'<iframe srcdoc="{page}" style="width:100%;height:34rem;border:0"></iframe>'


class Cube(Stack):
    """Bands of a spectrum, or light at angles of polarisation; a notebook shows false colours."""

    picture = "false-colour.png"

    @property
    def bands(self) -> tuple[str, ...]:
        """Wavelengths or angles, such as ``"450 nm"``."""
        return tuple(self.figures["bands"])

    @property
    def wavelengths_nm(self) -> tuple[float, ...]:
        """Of the bands; none where these are angles."""
        return tuple(Length.parse(each).nm for each in self.bands if each.endswith("m"))


class Video(Stack):
    """Frames of a video, which a notebook plays."""

    picture = "video.png"

    @property
    def times_s(self) -> tuple[float, ...]:
        """Middle of every frame, from the first line's exposure on."""
        frame_s = self.figures["video"]["frame_s"]
        return tuple((number + 0.5) * frame_s for number in range(len(self)))

    def save(self, path: str | Path) -> Path:
        """Write an .mp4, all frames as OME-TIFF (.tif), or pictures side by side (.png).

        Raises
        ------
        FileError
            If the suffix is another one, or the file cannot be written.
        """
        path = Path(path)
        check_output(path, [Path(name).suffix for name in self.writers])
        self.writers[f"video{path.suffix.lower()}"](path)
        return path

    def _repr_html_(self) -> str | None:
        if "video.mp4" not in self.writers:
            return None
        data = b64encode(self._written("video.mp4")).decode("ascii")
        return f'<video controls loop src="data:video/mp4;base64,{data}"></video>'


def reconstruct_volume(
    measurement: Raw,
    psf: Raw | Mapping[str | Length, Raw],
    depths: Sequence[str | Length],
    *,
    camera: str | Path | Camera | None = None,
    support: Support | Literal["auto", "full"] = "auto",
    dark: Raw | None = None,
    flat: Raw | None = None,
    progress: Progress = False,
    **options: Any,
) -> Volume:
    """Reconstruct planes at several depths, whose light adds up in the measurement.

    Parameters
    ----------
    measurement, support, dark, flat, progress
        As `reconstruct` takes them.
    psf
        The folder of a camera; PSFs by the distance of their point sources, such as ``{"8cm": near,
        "50cm": far}``; or one PSF, with the option `distance`.
    depths
        Two or more, such as ``["8cm", "20cm", "infinity"]``.
    camera
        Where `psf` is no folder: its layers say how a PSF changes with the distance.
    options
        Others of ``nolens reconstruct --depths``, by name: ``prior="l1"``, ``tau=1e-4``, ``bin=2``.

    Raises
    ------
    NolensError
        If the data do not fit together or an option cannot be used.
    """
    known: dict[Depth, Frame] | None = None
    if isinstance(psf, Mapping):
        known = {_depth(each): frame_of(psf[each], f"PSF of {each}") for each in psf}
    given = {"measurement": measurement, "psf": None if known else psf, "dark": dark, "flat": flat}
    asked = {"depths": tuple(map(str, depths)), "output": _UNWRITTEN, **options}
    work = partial(reconstruct_depths, psfs=known)
    return Volume(**_solved(work, given, camera, support, asked, progress))


def reconstruct_cube(
    measurement: Raw,
    psf: Raw | Camera,
    bands: int | Sequence[str | Length | Angle],
    *,
    camera: str | Path | Camera | None = None,
    support: Support | Literal["auto", "full"] = "auto",
    dark: Raw | None = None,
    flat: Raw | None = None,
    progress: Progress = False,
    **options: Any,
) -> Cube:
    """Reconstruct the spectrum, or the polarisation, of every scene pixel.

    Parameters
    ----------
    measurement, support, dark, flat, progress
        As `reconstruct` takes them; counts and support on all pixels of the sensor.
    psf
        The folder of a camera, a PSF on all pixels of the sensor, or a described camera, which
        then simulates the PSF of each band.
    bands
        How many; or wavelengths such as ``"450nm"``, or angles such as ``"45deg"``.
    camera
        Where `psf` is neither a folder nor a camera: it says what each pixel sees.
    options
        Others of ``nolens reconstruct --bands``, by name: ``spectral_smoothness=0.1``.

    Raises
    ------
    NolensError
        If the data do not fit together or an option cannot be used.
    """
    if isinstance(psf, Camera):
        psf, camera = _UNWRITTEN / CAMERA_FILE, psf  # A folder without a list of PSFs.
    if support == "auto" and isinstance(measurement, SimulatedMeasurement):
        support = measurement.support.finer(1 if measurement.frame.mosaic is None else 2)
    given = {"measurement": measurement, "psf": psf, "dark": dark, "flat": flat}
    named = str(bands) if isinstance(bands, int) else ",".join(map(str, bands))
    asked = {"bands": named, "output": _UNWRITTEN, **options}
    return Cube(**_solved(reconstruct_bands, given, camera, support, asked, progress))


def reconstruct_video(
    measurement: Raw,
    psf: Raw,
    frames: int,
    *,
    camera: str | Path | Camera | None = None,
    support: Support | Literal["auto", "full"] = "auto",
    dark: Raw | None = None,
    flat: Raw | None = None,
    progress: Progress = False,
    **options: Any,
) -> Video:
    """Reconstruct a video from one measurement of a rolling shutter.

    Parameters
    ----------
    measurement, dark, flat, progress
        As `reconstruct` takes them.
    psf
        The folder of a camera, or a PSF.
    frames
        How many, such as 24.
    camera
        Where no description lies beside `psf`: it says when the sensor's lines are exposed.
    support
        As `reconstruct` takes it; ``"auto"`` is that of a simulated measurement alone.
    options
        Others of ``nolens reconstruct --frames``, by name: ``exposure="1ms"``, ``detail=2``.

    Raises
    ------
    NolensError
        If the data do not fit together or an option cannot be used.
    """
    suffixes = [".png", ".tif", *([".mp4"] if has_video_support() else [])]
    outputs = tuple(_UNWRITTEN.with_name(f"video{suffix}") for suffix in suffixes)
    given = {"measurement": measurement, "psf": psf, "dark": dark, "flat": flat}
    asked = {"frames": frames, "output": outputs, **options}
    return Video(**_solved(reconstruct_frames, given, camera, support, asked, progress))


def _solved(
    work: Callable[[Run[ReconstructOptions]], Product[Tensor]],
    given: Mapping[str, Any],
    camera: str | Path | Camera | None,
    support: Support | Literal["auto", "full"],
    asked: dict[str, Any],
    progress: Progress,
) -> dict[str, Any]:
    """What the work of a job gives, as the fields of a `Stack`.

    Parameters
    ----------
    work
        Of the job.
    given
        Frames by the option that names them: files, or what `frame_of` takes.
    camera
        That measured, where the files do not say it.
    support
        Of the scene.
    asked
        The other options.
    progress
        As the front door's functions take it.
    """
    measurement = given["measurement"]
    if support == "auto" and isinstance(measurement, SimulatedMeasurement):
        support = measurement.binned_support(asked.get("bin", 1))
    frames = {}
    named: dict[str, Any] = {"psf": Path("<psf>")}
    for option, each in given.items():
        if isinstance(each, (str, Path)):
            named[option] = each
        elif each is not None:
            own = isinstance(each, SimulatedMeasurement)
            name = "PSF" if option == "psf" else option
            frames[option] = each.frame if own else frame_of(each, name)
            # Messages have these names.
            named[option] = Path("<psf>" if option == "psf" else f"the {option}")
    options = ReconstructOptions.gather(
        {"device": "cpu", **named, **asked, "support": _support_text(support)}
    )
    if camera is not None and not isinstance(camera, Camera):
        camera = Camera(camera)
    with reported(progress, "scenes") as report:
        reporter = _StageReporter(report)
        run = _NotebookRun(options, reporter, frames, camera)
        product = work(run)
        report(1.0)
    count = product.value.shape[1] if product.value.ndim == 4 else 1
    return {
        "values": product.value.cpu(),
        "channels": ("R", "G", "B") if count == 3 else ("grey",),
        "figures": dict(product.figures),
        "notes": tuple(reporter.notes),
        "warnings": tuple(run.warnings),
        "writers": {path.name: write for path, write in product.writers.items()},
    }


class _NotebookRun(Run[ReconstructOptions]):
    """A run whose frames and camera are at hand, and which writes no file."""

    def __init__(
        self,
        options: ReconstructOptions,
        reporter: Reporter,
        frames: Mapping[str, Frame],
        camera: Camera | None,
    ) -> None:
        self._frames, self._camera = frames, camera
        super().__init__(options, reporter)

    def reads(self, files: Mapping[str, Path]) -> None:
        """Nothing is written over them, and no record has their hashes."""

    def frame(self, option: str, *, mosaic: str | None = None, bgr: bool = False) -> Frame:
        given = self._frames.get(option)
        return super().frame(option, mosaic=mosaic, bgr=bgr) if given is None else given

    def camera_beside(self, name: str | None, folder: Path | None) -> LoadedCamera | None:
        given = self._camera
        return super().camera_beside(name, folder) if given is None else given.read_out

    def twin(
        self, loaded: LoadedCamera, working: float, remedy: str, *, fresnel: bool = True
    ) -> Twin:
        if self._camera is None:
            return super().twin(loaded, working, remedy, fresnel=fresnel)
        check_simulation_memory(loaded, working, self.device, remedy)
        return self._camera.twin


class _StageReporter(CallbackReporter):
    """Of a job with a solver: each stage before it is half of what is left until then."""

    def __init__(self, report: Callable[[float], None]) -> None:
        super().__init__(report)
        self._stages: list[str] = []

    def advance(self, what: str, fraction: float) -> None:
        if what not in self._stages:
            self._stages.append(what)
        super().advance(what, _BEFORE * (1 - 0.5 ** (len(self._stages) - 1 + fraction)))

    def progress(self, progress: Iteration, limit: int) -> bool:
        self._report(_BEFORE + (1 - _BEFORE) * progress.iteration / limit)
        return False


def _support_text(support: Support | Literal["auto", "full"]) -> str:
    if isinstance(support, tuple) and len(support) == 2:
        return f"{support[0]}x{support[1]}"
    if isinstance(support, tuple):
        support = PixelRectangle(*support)
    return support if isinstance(support, str) else support.text


def _depth(distance: str | Length) -> Depth:
    um = distance_um(distance)
    return "infinity" if math.isinf(um) else Length.of(um, "um")
