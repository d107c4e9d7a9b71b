"""What `nolens calibrate pairs` can be told, as a frozen model."""

from pathlib import Path
from typing import Any, Self

from nolens.camera.part import Counts, PixelPitch
from nolens.camera.psf_set import Depth
from nolens.errors import FileError, OptionError
from nolens.files import PSFS_FILE
from nolens.jobs.calibration.point_options import distance_name
from nolens.jobs.fields import FilePath, Window, Word
from nolens.jobs.options import JobOptions, Written

_COMMAND = "nolens calibrate pairs MEASURED PICTURES --distance 300mm -o FOLDER"


class CalibratePairsOptions(JobOptions):
    """What `nolens calibrate pairs` can be told.

    Attributes
    ----------
    measured, pictures
        Folders of what the camera measured and of what it saw; a pair has one name in both.
    output
        Folder of the camera's PSFs.
    distance
        Of the pictures from the camera.
    pixel
        Distance of the pixels in the measurements; None takes that of the folder's camera.
    dark
        A measurement without light.
    black, white
        Counts of no light and of saturation, in place of what the files say.
    mosaic
        Of measurements whose files do not say it.
    bgr
        The channels of all files are in the order B, G, R.
    region
        Where the pictures' cells lie in the sensor's frame; None: in the middle.
    each_channel
        A PSF for each channel, in place of one for all.
    check
        Whether to solve without each of the pairs in turn, and to reconstruct it.
    """

    measured: FilePath
    pictures: FilePath
    output: FilePath
    distance: Depth
    pixel: PixelPitch | None = None
    dark: FilePath | None = None
    black: Counts | None = None
    white: Counts | None = None
    mosaic: Word | None = None
    bgr: bool = False
    region: Window | None = None
    each_channel: bool = False
    check: bool = False

    @classmethod
    def gather(cls, given: dict[str, Any]) -> Self:
        """Options as the command line gives them.

        Raises
        ------
        OptionError
            If one is missing, or its value cannot be used.
        """
        for name, what in (
            ("measured", f"no folder of measurements is given: {_COMMAND}"),
            ("pictures", f"no folder of pictures is given: {_COMMAND}"),
            ("output", "no output is given; name the folder of the camera's PSFs (-o folder)"),
            (
                "distance",
                "no distance is given: say how far the pictures were from the camera "
                "(--distance 300mm, or infinity)",
            ),
        ):
            if not given.get(name):
                raise OptionError(what)
        return cls.checked(given)

    @property
    def psf(self) -> Path:
        """File of the PSF."""
        return self.output / f"solved-{distance_name(self.distance)}.tif"

    @property
    def record(self) -> Path:
        """File of the run's record."""
        return self.output / f"pairs-{distance_name(self.distance)}.json"

    @property
    def inputs(self) -> dict[str, Path]:
        """Dark frame, by role; the pairs are found in their folders."""
        return {} if self.dark is None else {"dark frame": self.dark}

    @property
    def written(self) -> tuple[Written, ...]:
        """PSF, list and record."""
        return (
            Written("PSF", self.psf),
            Written("list of PSFs", self.output / PSFS_FILE),
            Written("record of the run", self.record),
        )


def named_pairs(measured: Path, pictures: Path) -> dict[str, tuple[Path, Path]]:
    """Files of the same name, but for the suffix, in both folders, in the order of their names.

    Raises
    ------
    FileError
        If a folder is none or has two files of one name, or a file has no partner.
    """
    found = [_by_name(folder) for folder in (measured, pictures)]
    for folder, here, there, other in (
        (measured, found[0], found[1], pictures),
        (pictures, found[1], found[0], measured),
    ):
        alone = sorted(here.keys() - there.keys())
        if alone:
            raise FileError(
                f"{folder / here[alone[0]].name} has no partner in {other} ({len(found[0])} "
                f"measurements, {len(found[1])} pictures): give both the same name, such as "
                f"{alone[0]}.png, and keep other files elsewhere"
            )
    if not found[0]:
        raise FileError(f"{measured} is empty: give a folder of measurements, and one of pictures")
    return {name: (found[0][name], found[1][name]) for name in sorted(found[0])}


def _by_name(folder: Path) -> dict[str, Path]:
    if not folder.is_dir():
        raise FileError(f"{folder} is no folder: give one of measurements and one of pictures")
    files: dict[str, Path] = {}
    for path in sorted(folder.iterdir()):
        if path.name.startswith(".") or not path.is_file():
            continue
        if path.stem in files:
            raise FileError(
                f"{path} and {files[path.stem].name} have one name, and it is not clear which is "
                "meant: keep one of them elsewhere"
            )
        files[path.stem] = path
    return files
