"""What `nolens camera relief` can be told, as a frozen model."""

from pathlib import Path
from typing import Any, Literal, Self

from nolens.camera.part import PositiveLength
from nolens.errors import OptionError
from nolens.files import CAMERA_FILE
from nolens.jobs.fields import FilePath, Name
from nolens.jobs.options import JobOptions, Written

RELIEF_FILE = "relief.tif"
"""Name of the heights in the folder of the camera."""
RECORD_FILE = "relief.json"
"""Name of the record of where they come from."""


class ReliefOptions(JobOptions):
    """What `nolens camera relief` can be told.

    Attributes
    ----------
    camera
        Preset, folder or .toml file.
    map
        File of heights.
    output
        Folder of the new camera.
    pitch
        Distance of the map's points; None takes what the file says.
    unit
        Length that a value of 1 stands for.
    full_scale
        Height that the largest count of a TIFF of whole numbers stands for.
    invert
        Heights count downwards, as those of a mould do.
    mirror
        Top and bottom are exchanged: the map shows the mask from the scene.
    turn
        Degrees by which the map is turned anticlockwise, after `mirror`.
    keep_tilt
        The best-fit plane is left in.
    grid
        Distance of the points of the camera's relief; None takes that of the relief described,
        or of the pixels.
    tile
        A map that is too small is continued by reflection.
    """

    camera: Name
    map: FilePath
    output: FilePath
    pitch: PositiveLength | None = None
    unit: Literal["nm", "um", "mm", "m"] | None = None
    full_scale: PositiveLength | None = None
    invert: bool = False
    mirror: bool = False
    turn: Literal[0, 90, 180, 270] = 0
    keep_tilt: bool = False
    grid: PositiveLength | None = None
    tile: bool = False

    @classmethod
    def gather(cls, given: dict[str, Any]) -> Self:
        """Options as the command line gives them.

        Raises
        ------
        OptionError
            If one is missing, or its value cannot be used.
        """
        if not given.get("output"):
            raise OptionError("no output is given; name the folder of the new camera (-o folder)")
        return cls.checked(given)

    @property
    def inputs(self) -> dict[str, Path]:
        """The map."""
        return {"map": self.map}

    @property
    def written(self) -> tuple[Written, ...]:
        """Description, relief and record."""
        names = {"camera": CAMERA_FILE, "relief": RELIEF_FILE, "record": RECORD_FILE}
        return tuple(Written(what, self.output / name) for what, name in names.items())
