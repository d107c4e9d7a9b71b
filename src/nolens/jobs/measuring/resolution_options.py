"""What the commands of `nolens measure resolution` can be told."""

from pathlib import Path
from typing import Annotated, Any, Self

from pydantic import Field

from nolens.camera.part import PositiveLength
from nolens.camera.psf_set import Depth
from nolens.errors import OptionError
from nolens.jobs.fields import (
    FilePath,
    Files,
    Iterations,
    Name,
    Seed,
    Tau,
    Window,
    Word,
    record_beside,
)
from nolens.jobs.options import JobOptions, Written
from nolens.quantities import Angle, Share
from nolens.ranges import Between

_Threshold = Annotated[Share, Between("0.01 %", "99.99 %")]
_CellAngle = Annotated[Angle, Between("0.000001 deg", "10 deg")]
_TargetAngle = Annotated[Angle, Between("0.001 deg", "89.9 deg")]
_FRAMES_ONLY = ("psf", "psf_wider", "dark", "region", "camera", "cell_angle")
_SIMULATED_ONLY = ("light", "wavelengths", "fill", "seed")
_LINEAR = (".tif", ".tiff", ".npy")


class ResolutionOptions(JobOptions):
    """What all targets have in common.

    Attributes
    ----------
    frames
        Raw frames of the target (with `psf`), or pictures that were reconstructed of them.
    simulate
        Camera to simulate in place of frames: preset, folder or .toml file.
    psf, psf_wider, dark
        With which frames are reconstructed, as `nolens reconstruct` takes them.
    region
        Cells that light can come from, or that the pictures show.
    camera
        It tells the angle of a cell; None takes the one beside the PSF.
    cell_angle
        The angle of a cell in the middle, in place of a camera.
    distance
        Of the target; None takes the simulated camera's reference_distance.
    iterations, tau
        Of ADMM; all iterations are done. None takes the target's own.
    light, wavelengths
        Of the simulation: the spectrum, and how many wavelengths stand for a channel.
    fill
        Share of a full pixel that the brightest one is exposed to.
    seed
        Of the sensor's noise.
    plot
        Picture to write; the record of the run goes beside it.
    """

    frames: Files = ()
    simulate: Name | None = None
    psf: FilePath | None = None
    psf_wider: bool = False
    dark: FilePath | None = None
    region: Window | None = None
    camera: Name | None = None
    cell_angle: _CellAngle | None = None
    distance: Depth | None = None
    iterations: Iterations | None = None
    tau: Tau | None = None
    light: Word = "white-led"
    wavelengths: Annotated[int, Between(1, 64)] = 1
    fill: Annotated[Share, Between("0.001 %", "100 %")] = Share("90", "%")
    seed: Seed = 0
    plot: FilePath | None = None

    @classmethod
    def gather(cls, given: dict[str, Any]) -> Self:
        """Options as the command line gives them.

        Raises
        ------
        OptionError
            If one is missing, or its value cannot be used, or two do not go together.
        """
        options = cls.checked(given)
        if not options.frames and options.simulate is None:
            raise OptionError(
                "nothing to measure is given: name frames or pictures of the target, or a camera "
                "to simulate (--simulate CAMERA)"
            )
        if options.frames and options.simulate is not None:
            raise OptionError(
                f"{options.frames[0]} and --simulate {options.simulate} are both given: measure "
                "frames, or simulate a camera"
            )
        simulated = options.simulate is not None
        for name in options.only(not simulated):
            if name in given:
                where = "frames" if simulated else "--simulate"
                raise OptionError(
                    f"--{name.replace('_', '-')} goes with {where} only: leave it out"
                )
        if not simulated:
            options.check_frames()
        return options

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
                ("psf-wider", self.psf_wider),
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
            if self.region is not None and self.cell_angle is not None:
                raise OptionError(
                    f"--region {self.region} says where on the sensor the pictures lie, which "
                    f"matters with --camera only: leave it out, or --cell-angle {self.cell_angle}"
                )
        if self.camera is not None and self.cell_angle is not None:
            raise OptionError(
                f"--camera {self.camera} and --cell-angle {self.cell_angle} both say how large a "
                "cell is: leave one out"
            )

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
        if self.plot is None or self.record is None:
            return ()
        return (
            Written("plot", self.plot, "--plot"),
            Written("record of the run", self.record, "--plot"),
        )


class TwoPointOptions(ResolutionOptions):
    """What `nolens measure resolution two-points` can be told.

    Attributes
    ----------
    separation
        Distance of the two points, of each frame.
    dip
        That counts as resolved.
    direction
        Of the line through the points, from the right towards up.
    draws
        Pictures of each separation.
    """

    separation: Annotated[tuple[PositiveLength, ...], Field(max_length=100_000)] = ()
    dip: _Threshold = Share("26.5", "%")
    direction: Annotated[Angle, Between("-360 deg", "360 deg")] = Angle("0", "deg")
    draws: Annotated[int, Between(1, 1000)] = 3

    @classmethod
    def only(cls, simulated: bool) -> tuple[str, ...]:
        """Options that only simulations take, or only frames."""
        own = ("direction", "draws") if simulated else ("separation",)
        return (*super().only(simulated), *own)

    def check_frames(self) -> None:
        """Refuse options for frames that do not go together.

        Raises
        ------
        OptionError
            If not every frame has a separation, or the distance is missing.
        """
        super().check_frames()
        if len(self.separation) != len(self.frames):
            raise OptionError(
                f"--separation is given {len(self.separation)} times for {len(self.frames)} "
                "frames: give it once for each, in their order, such as --separation 1.9mm"
            )
        if self.distance is None or self.distance == "infinity":
            raise OptionError(
                "the distance of the two points is not given: --distance, such as 180mm, makes "
                "angles of their separations"
            )


class OneFrameOptions(ResolutionOptions):
    """What the measurement of one picture can be told."""

    def check_frames(self) -> None:
        """Refuse options for frames that do not go together.

        Raises
        ------
        OptionError
            If there are more frames than one, or a distance that does not matter.
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


class SiemensOptions(OneFrameOptions):
    """What `nolens measure resolution siemens` can be told.

    Attributes
    ----------
    spokes
        Bright spokes of the star; None takes what is found, or 36 in a simulation.
    angle
        Field angle of the star, from side to side; None takes what is found, or 20deg.
    threshold
        Share of the contrast of wide spokes from which on they count as resolved.
    """

    spokes: Annotated[int, Between(4, 200)] | None = None
    angle: _TargetAngle | None = None
    threshold: _Threshold = Share("10", "%")


class EdgeOptions(OneFrameOptions):
    """What `nolens measure resolution edge` can be told.

    Attributes
    ----------
    angle
        Field angle that the simulated edge's picture fills.
    """

    angle: _TargetAngle = Angle("10", "deg")

    @classmethod
    def only(cls, simulated: bool) -> tuple[str, ...]:
        """Options that only simulations take, or only frames."""
        return (*super().only(simulated), *(("angle",) if simulated else ()))
