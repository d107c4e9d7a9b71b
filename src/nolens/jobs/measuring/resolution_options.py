"""What all commands of `nolens measure resolution` can be told."""

from pathlib import Path
from typing import Annotated, ClassVar

from nolens.camera.psf_set import Depth
from nolens.errors import OptionError
from nolens.experiments.resolution import TARGET_ITERATIONS, TAU, SolverSettings
from nolens.jobs.fields import (
    CAMERAS,
    LIGHTS,
    RESULT,
    FilePath,
    Files,
    Iterations,
    Name,
    PsfExtent,
    Seed,
    Tau,
    Window,
    Word,
    plot_and_record,
    record_beside,
)
from nolens.jobs.options import JobOptions, Option, Written
from nolens.quantities import Angle, Share
from nolens.ranges import Between

Threshold = Annotated[Share, Between("0.01 %", "99.99 %")]
_CellAngle = Annotated[Angle, Between("0.000001 deg", "10 deg")]
TargetAngle = Annotated[Angle, Between("0.001 deg", "89.9 deg")]
_FRAMES_ONLY = ("psf", "psf_extent", "dark", "support", "camera", "cell_angle")
_SIMULATED_ONLY = ("light", "wavelengths", "fill", "seed")
_LINEAR = (".tif", ".tiff", ".npy")
TARGET, _FRAMES, SIMULATION, _SOLVER = "Target", "Frames", "Simulation", "Solver"
"""Headings."""


def frames_option(text: str) -> Option:
    """Declare the frames of a target, with a text of its own."""
    return Option(text, role="input", positional=True, label="Picture")


class ResolutionOptions(JobOptions):
    """What all targets have in common.

    Attributes
    ----------
    default_iterations
        Of ADMM, where none are given.
    """

    default_iterations: ClassVar[int] = TARGET_ITERATIONS

    frames: Annotated[
        Files,
        frames_option(
            "Raw frames of the target, or pictures of it that nolens reconstruct wrote (.tif, "
            ".npy)."
        ),
    ] = ()
    distance: Annotated[
        Depth | None,
        Option(
            "From the camera to the target.",
            TARGET,
            default="the simulated camera's reference_distance",
            label="Distance",
        ),
    ] = None
    psf: Annotated[
        FilePath | None,
        Option(
            "PSF to reconstruct raw frames with, captured at that distance.", _FRAMES, role="input"
        ),
    ] = None
    psf_extent: PsfExtent = "sensor"
    dark: Annotated[FilePath | None, Option("Dark frame.", _FRAMES, role="input")] = None
    support: Annotated[
        Window | None,
        Option(
            "Scene pixels that light can come from, as nolens reconstruct takes it; of pictures, "
            "those that they show.",
            _FRAMES,
            default="the sensor's; of pictures, as many around its middle",
            former="region",
        ),
    ] = None
    camera: Annotated[
        Name | None,
        Option(
            f"That took the frames: {CAMERAS}. It tells the angles of scene pixels.",
            _FRAMES,
            default="camera.toml beside the PSF",
            role="camera",
            label="Camera",
        ),
    ] = None
    cell_angle: Annotated[
        _CellAngle | None,
        Option(
            "The angle of a scene pixel in the middle, in place of a camera, such as 0.138deg.",
            _FRAMES,
        ),
    ] = None
    simulate: Annotated[
        Name | None,
        Option(
            f"Camera to simulate in place of frames: {CAMERAS}.",
            SIMULATION,
            role="camera",
            label="Camera",
        ),
    ] = None
    light: Annotated[Word, Option(f"{LIGHTS}.", SIMULATION)] = "white-led"
    wavelengths: Annotated[
        int, Between(1, 64), Option("How many stand for a channel of the sensor.", SIMULATION)
    ] = 1
    fill: Annotated[
        Share,
        Between("0.001 %", "100 %"),
        Option("Fraction of a full pixel that the brightest one is exposed to.", SIMULATION),
    ] = Share("90", "%")
    seed: Annotated[Seed, Option("Of the noise.", SIMULATION)] = 0
    iterations: Annotated[
        Iterations | None,
        Option("Of ADMM; all of them are done.", _SOLVER, default="300; two points 100"),
    ] = None
    tau: Annotated[Tau | None, Option("Weight of the prior.", _SOLVER, default="1e-5")] = None
    plot: Annotated[
        FilePath | None,
        Option(
            "Picture to write (.png) of what was measured. The record of the run goes beside it, "
            "as .json.",
            RESULT,
            role="output",
        ),
    ] = None

    def check_together(self) -> None:
        """Refuse all but one of frames and a simulation, and options that go with the other."""
        if not self.frames and self.simulate is None:
            raise OptionError(
                "nothing to measure is given: name frames or pictures of the target, or a camera "
                "to simulate (--simulate CAMERA)"
            )
        if self.frames and self.simulate is not None:
            raise OptionError(
                f"{self.frames[0]} and --simulate {self.simulate} are both given: measure "
                "frames, or simulate a camera"
            )
        simulated = self.simulate is not None
        for name in self.only(not simulated):
            if name in self.model_fields_set:
                where = "frames" if simulated else "--simulate"
                raise OptionError(
                    f"--{name.replace('_', '-')} goes with {where} only: leave it out"
                )
        if not simulated:
            self.check_frames()

    @classmethod
    def only(cls, simulated: bool) -> tuple[str, ...]:
        """Options that only simulations take, or only frames."""
        return _SIMULATED_ONLY if simulated else _FRAMES_ONLY

    def check_frames(self) -> None:
        """Refuse options for frames that do not go together.

        Raises
        ------
        OptionError
            If a picture is no linear one, or the angle of a cell is given twice or not at all.
        """
        if self.psf is None:
            for name, value in (
                ("psf-extent", self.psf_extent == "wide"),
                ("dark", self.dark),
                ("iterations", self.iterations),
                ("tau", self.tau),
            ):
                if value:
                    raise OptionError(
                        f"--{name} goes with raw frames, which --psf reconstructs: give --psf too, "
                        f"or leave --{name} out"
                    )
            for path in self.frames:
                if path.suffix.lower() not in _LINEAR:
                    raise OptionError(
                        f"{path} is no linear picture: without --psf, give pictures that nolens "
                        f"reconstruct wrote as {_LINEAR[0]}; with --psf, raw frames"
                    )
            if self.support is not None and self.cell_angle is not None:
                raise OptionError(
                    f"--support {self.support} says where on the sensor the pictures lie, which "
                    f"matters with --camera only: leave it out, or --cell-angle {self.cell_angle}"
                )
        if self.camera is not None and self.cell_angle is not None:
            raise OptionError(
                f"--camera {self.camera} and --cell-angle {self.cell_angle} both say how large a "
                "cell is: leave one out"
            )

    @property
    def settings(self) -> SolverSettings:
        """How pictures are taken and solved."""
        iterations = self.iterations or self.default_iterations
        return SolverSettings(iterations, self.tau or TAU, self.fill.value, self.seed)

    @property
    def record(self) -> Path | None:
        """File of the run's record, beside the plot."""
        return None if self.plot is None else record_beside(self.plot)

    @property
    def inputs(self) -> dict[str, Path]:
        """Files that are read, by role, but for the camera's."""
        several = len(self.frames) > 1
        frames = {
            f"frame {number}" if several else "frame": path
            for number, path in enumerate(self.frames, start=1)
        }
        more = {"PSF": self.psf, "dark frame": self.dark}
        return frames | {role: path for role, path in more.items() if path is not None}

    @property
    def written(self) -> tuple[Written, ...]:
        """Plot and record."""
        return plot_and_record(self.plot)


class OneFrameOptions(ResolutionOptions):
    """What the measurement of one picture can be told."""

    def check_frames(self) -> None:
        """Refuse options for frames that do not go together.

        Raises
        ------
        OptionError
            If there are more frames than one.
        """
        super().check_frames()
        if len(self.frames) > 1:
            raise OptionError(
                f"{len(self.frames)} frames are given: one picture of the target is measured at a "
                "time"
            )

    @classmethod
    def only(cls, simulated: bool) -> tuple[str, ...]:
        """Options that only simulations take, or only frames."""
        return (*super().only(simulated), *(("distance",) if simulated else ()))
