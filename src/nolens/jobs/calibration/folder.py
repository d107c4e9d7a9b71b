"""What the jobs have in common that add PSFs to a camera's folder."""

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, ClassVar, Literal

from torch import Tensor

from nolens.calibrate.distances import Layers
from nolens.camera import Camera, FieldPsf, PsfEntry, PsfKind, Sensor
from nolens.camera.part import PositiveLength
from nolens.camera.psf_set import Depth
from nolens.files import CAMERA_FILE, PSFS_FILE, write_psfs
from nolens.jobs.fields import FilePath
from nolens.jobs.options import RECORD, JobOptions, Option, Written
from nolens.jobs.run import Product, Value, Writer
from nolens.quantities import Angle, Length


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


def place_name(distance: Length | Literal["infinity"], angle: tuple[Angle, Angle]) -> str:
    """Place of a point source as the names of files have it: its distance, and angles but zero."""
    text = distance_name(distance)
    if any(each.deg != 0 for each in angle):
        text += "".join(f"-{each.deg:.6g}deg" for each in angle)
    return text


def filter_warnings(sensor: Sensor | None, source: str) -> list[str]:
    """Warn of a PSF that was captured through the filters of a sensor's pixels.

    Parameters
    ----------
    sensor
        Of the folder's camera; None where that is not described.
    source
        The PSF's file, for messages.
    """
    array = None if sensor is None else sensor.filters
    if array is None or array.transmission is None:
        return []
    return [
        f"{source} was captured through the filters of the sensor's pixels ({CAMERA_FILE}), whose "
        "pattern is still in the PSF: reconstructions take the filters for a part of the mask's "
        "pattern, too. Give a frame of the point source, and one of even light of the same colour "
        "that the pattern is divided by (nolens calibrate import FRAME --flat EVEN)"
    ]


def field_entries(
    psfs: FieldPsf,
    camera: Camera,
    pixel: Length,
    distance: Length | Literal["infinity"],
    kind: PsfKind,
) -> dict[PsfEntry, Tensor]:
    """PSFs over the field as entries of a folder, each at the angle whose ray falls at its place.

    Parameters
    ----------
    psfs
        On the camera's superpixels.
    camera
        With the layers between mask and sensor.
    pixel
        Pitch of the superpixels.
    distance, kind
        Of all of them.
    """
    layers = Layers.of_camera(camera)
    made: dict[PsfEntry, Tensor] = {}
    for values, (row, column) in zip(psfs.values, psfs.places.tolist(), strict=True):
        angle = layers.angle_at((column * pixel.um, -row * pixel.um))
        entry = PsfEntry(
            file=f"psf-{place_name(distance, angle)}.tif",
            pixel=pixel,
            channels=tuple(camera.sensor.channels),
            distance=distance,
            angle=angle,
            kind=kind,
        )
        made[entry] = values
    return made


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
            Written(RECORD, self.record, self.folder_option),
        )


class FolderOptions(NewPsfOptions):
    """What the jobs have in common that add PSFs to a folder which has some."""

    folder_option: ClassVar[str] = "FOLDER"
    folder: Annotated[FilePath, psf_folder("Of the camera's PSFs, as nolens calibrate makes it.")]

    @property
    def output_folder(self) -> Path:
        """That of the PSFs."""
        return self.folder


def added(
    value: Value,
    figures: Mapping[str, Any],
    folder: Path,
    psfs: Mapping[PsfEntry, Tensor],
    more: Mapping[str, Writer] | None = None,
    sensor: tuple[int, int] | None = None,
) -> Product[Value]:
    """What a job hands over that adds PSFs, and more files by name, to a folder and to its list."""
    writers = {folder / name: write for name, write in (more or {}).items()}
    outputs = (*(folder / entry.file for entry in psfs), folder / PSFS_FILE, *writers)

    return Product(
        value,
        figures,
        writers,
        outputs=outputs,
        commit=lambda files: write_psfs(folder, psfs, more=files, sensor=sensor),
    )
