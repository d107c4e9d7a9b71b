"""The folder that a camera's PSFs are gathered in: what the jobs that add to it have in common."""

from collections.abc import Mapping
from decimal import Decimal
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, ClassVar, Literal

from torch import Tensor

from nolens.calibrate.distances import Layers
from nolens.camera import Frame, LoadedCamera, PsfEntry, PsfKind, PsfSet
from nolens.camera.part import PositiveLength
from nolens.camera.psf_set import Depth
from nolens.errors import DataError, FileError, OptionError
from nolens.files import CAMERA_FILE, PSFS_FILE, read_camera, read_psf_set, write_psfs
from nolens.jobs.fields import FilePath
from nolens.jobs.options import JobOptions, Option, Written
from nolens.jobs.run import Product, Value, Writer
from nolens.quantities import Length

RESULT = "Result"


def psf_folder(text: str) -> Option:
    """The option of a folder that has PSFs."""
    return Option(
        text,
        needed="the folder of the camera's PSFs, as nolens calibrate makes it",
        role="input",
        positional=True,
    )


def output_folder(record: str) -> Option:
    """The option of a folder that PSFs are added to; it may be a new one."""
    return Option(
        "Folder of the camera's PSFs; made if it is not there. The PSF, the list psfs.toml and "
        f"the record {record}-….json go into it.",
        RESULT,
        needed="the folder of the camera's PSFs (-o folder)",
        role="output",
        flag="-o",
    )


Reduced = Annotated[
    PositiveLength | None,
    Option(
        "Sum of thickness / index of the layers between mask and sensor, such as 1.28mm, where "
        "the folder has no camera.toml."
    ),
]


def distance_name(distance: Length | Literal["infinity"]) -> str:
    """A distance as the names of files have it, the same for 30 cm and 300 mm."""
    return f"{distance.mm:.6g}mm" if isinstance(distance, Length) else distance


class NewPsfOptions(JobOptions):
    """What the jobs have in common that add a PSF to a folder, ``output``.

    Attributes
    ----------
    names
        How the names of the PSF and of the record begin.
    """

    names: ClassVar[tuple[str, str]]
    folder_option: ClassVar[str] = "-o"
    if TYPE_CHECKING:
        # Each job declares them at their own place among its fields, with its own text.
        output: FilePath
        distance: Depth | None

    @property
    def suffix(self) -> str | None:
        """What the names of files end with; None until the distance in it is known."""
        return None if self.distance is None else distance_name(self.distance)

    @property
    def psf_file(self) -> str:
        """Name of the PSF's file."""
        return f"{self.names[0]}-{self.suffix}.tif"

    @property
    def output_folder(self) -> Path:
        """It is made where it does not exist."""
        return self.output

    @property
    def record(self) -> Path | None:
        """File of the run's record."""
        suffix = self.suffix
        return None if suffix is None else self.output_folder / f"{self.names[1]}-{suffix}.json"

    @property
    def written(self) -> tuple[Written, ...]:
        """PSF, list and record."""
        if self.record is None:
            return ()
        return (
            Written("PSF", self.output_folder / self.psf_file, self.folder_option),
            Written("list of PSFs", self.output_folder / PSFS_FILE, self.folder_option),
            Written("record of the run", self.record, self.folder_option),
        )


class FolderOptions(NewPsfOptions):
    """What the jobs have in common that add PSFs to a folder which has some."""

    folder_option: ClassVar[str] = "FOLDER"
    folder: Annotated[FilePath, psf_folder("Of the camera's PSFs, as nolens calibrate makes it.")]

    @property
    def output_folder(self) -> Path:
        """That of the PSFs."""
        return self.folder

    @property
    def inputs(self) -> dict[str, Path]:
        """Nothing but what the folder lists."""
        return {}


def folder_camera(folder: Path) -> LoadedCamera | None:
    """The camera of a folder of PSFs, if it has one."""
    path = folder / CAMERA_FILE
    return read_camera(path) if path.is_file() else None


def folder_psfs(folder: Path) -> PsfSet | None:
    """The list of a folder's PSFs, if it has one."""
    return read_psf_set(folder) if (folder / PSFS_FILE).is_file() else None


def folder_layers(folder: Path, reduced: Length | None) -> tuple[Layers, dict[str, Path]]:
    """The layers of a folder's camera, or those of a reduced thickness; and the file they are from.

    Raises
    ------
    OptionError
        If there is neither, or both.
    """
    loaded = folder_camera(folder)
    if loaded is not None and reduced is not None:
        raise OptionError(
            f"--reduced {reduced}: the folder has a {CAMERA_FILE}, whose layers say the same. "
            "Leave --reduced out, or mend the layers"
        )
    if loaded is not None:
        return Layers.of_camera(loaded.camera), {"camera": folder / CAMERA_FILE}
    if reduced is None:
        raise OptionError(
            f"the folder has no {CAMERA_FILE}: give the reduced thickness between mask and sensor, "
            "the sum of thickness / index of all layers (--reduced 1.28mm)"
        )
    return Layers.of_air(reduced.um), {}


def psfs_ahead(folder: Path, psfs: PsfSet, kinds: tuple[PsfKind, ...]) -> list[PsfEntry]:
    """PSFs of sources straight ahead, in the frame of the chief ray, nearest first.

    Raises
    ------
    DataError
        If there is none.
    """
    ahead = [each for each in psfs.by_distance(kinds) if each.frame == "chief-ray"]
    if not ahead:
        kind = "captured" if kinds == ("captured",) else "measured"
        raise DataError(
            f"{folder} has no {kind} PSF of a light straight ahead: add one first, with "
            "nolens calibrate FRAME... --distance 300mm"
        )
    return ahead


def made_of(source: PsfEntry, file: str, kind: PsfKind, **changes: Any) -> PsfEntry:
    """Entry of a PSF, of a source straight ahead, that is made of another one of the folder."""
    of_source = {"distance": source.distance, "usable_per_mm": source.usable_per_mm}
    return PsfEntry(
        file=file,
        pixel=source.pixel,
        channels=source.channels,
        kind=kind,
        **{**of_source, **changes},
    )


def check_channels(psfs: PsfSet | None, channels: tuple[str, ...], remedy: str = "") -> None:
    """Refuse a PSF whose channels are not those of the folder's.

    Raises
    ------
    OptionError
        If they are not.
    """
    if psfs is not None and psfs.psf[0].channels != channels:
        raise OptionError(
            f"the PSF {psfs.psf[0].file} of the folder has the channels "
            f"{', '.join(psfs.psf[0].channels)}, but this one would have {', '.join(channels)}: "
            f"give another folder (-o){remedy}"
        )


def added(
    value: Value,
    figures: Mapping[str, Any],
    folder: Path,
    psfs: Mapping[PsfEntry, Tensor],
    more: Mapping[str, Writer] | None = None,
) -> Product[Value]:
    """What a job hands over that adds PSFs, and more files by name, to a folder and to its list."""
    writers = {folder / name: write for name, write in (more or {}).items()}
    outputs = (*(folder / entry.file for entry in psfs), folder / PSFS_FILE, *writers)

    def commit(writers: Mapping[Path, Writer]) -> None:
        names = {str(path.relative_to(folder)): write for path, write in writers.items()}
        write_psfs(folder, psfs, more=names)

    return Product(value, figures, writers, outputs=outputs, commit=commit)


def chosen_camera(folder: Path, name: str | None) -> tuple[LoadedCamera | None, str | None]:
    """The camera of a name, or else of the folder; and its name if it is new to the folder.

    Raises
    ------
    OptionError
        If the folder has the description of another one.
    """
    own = folder_camera(folder)
    if name is None:
        return own, None
    loaded = read_camera(name)
    if own is None:
        return loaded, name
    if own.camera != loaded.camera:
        raise OptionError(
            f"--camera {name} is not the camera that {folder / CAMERA_FILE} describes: leave "
            "--camera out, or give another folder (-o)"
        )
    return own, None


def check_free(folder: Path, names: list[str]) -> None:
    """Refuse to write a camera's files over others.

    Raises
    ------
    FileError
        If one of them is there.
    """
    for name in names:
        if (folder / name).exists():
            raise FileError(
                f"the camera's {name} would overwrite {folder / name}: give another folder (-o)"
            )


def pixel_of(
    frame: Frame, loaded: LoadedCamera | None, psfs: PsfSet | None, pitch: Length | None
) -> Length:
    """Pitch of the pixels of the reconstruction: of a frame's pixels, or its 2×2 superpixels.

    The camera, or PSFs of it, say it, or the stated pitch of the frame's pixels.

    Raises
    ------
    NolensError
        If nothing says it, or the frame's size or pixels are not the camera's.
    """
    of_folder = None if psfs is None else psfs.psf[0]
    bin_by = 1 if frame.mosaic is None else 2
    stated = None if pitch is None else _times(pitch, bin_by)
    known: Length | None = None
    if loaded is not None:
        known, named = _pixel_of_camera(frame, loaded), f"the camera {loaded.camera.name!r}"
    elif of_folder is not None:
        known, named = of_folder.pixel, f"the PSF {of_folder.file}"
    pixel = known or stated
    if pixel is None:
        raise OptionError(
            "the distance of the pixels is not known: give it (--pixel 1.55um), or the camera "
            "(--camera)"
        )
    if stated is not None and known is not None and stated != known:
        each = "a pixel" if bin_by == 1 else "2 of its pixels"
        raise OptionError(
            f"--pixel {pitch}: a pixel of {named} is {known} wide, but {each} are {stated}; leave "
            "--pixel out, or give another folder (-o)"
        )
    if of_folder is not None and of_folder.pixel != pixel:
        raise DataError(
            f"the PSF {of_folder.file} of the folder has pixels of {of_folder.pixel}, but these "
            f"frames {pixel}: they are of another camera. Give another folder (-o)"
        )
    return pixel


def _pixel_of_camera(frame: Frame, loaded: LoadedCamera) -> Length:
    """Pitch of a camera's pixels or superpixels; a frame that is not of it is refused."""
    sensor = loaded.camera.sensor
    bin_by = 1 if sensor.mosaic == "none" else 2
    if frame.mosaic is None and frame.channels == ("R", "G", "B") and bin_by == 2:
        size, what = (sensor.rows // 2, sensor.columns // 2), "superpixels"
    else:
        size, what = (sensor.rows, sensor.columns), "pixels"
    if tuple(frame.counts.shape[-2:]) != size:
        raise DataError(
            f"{frame.source} has {frame.size_text} pixels, but the camera "
            f"{loaded.camera.name!r} has {size[0]}×{size[1]} {what}: give frames of this "
            "camera, whole and not binned"
        )
    if frame.mosaic is not None and frame.mosaic != sensor.mosaic:
        raise DataError(
            f"{frame.source} has the colour mosaic {frame.mosaic}, but the camera "
            f"{loaded.camera.name!r} has {sensor.mosaic}: give frames of this camera, not turned"
        )
    return _times(sensor.pitch, bin_by)


def _times(length: Length, factor: int) -> Length:
    return Length(f"{(Decimal(length.number) * factor).normalize():f}", length.unit)
