"""Options of `nolens reconstruct`, and what texts of windows and --flip mean."""

from pathlib import Path
from typing import Annotated, Literal

from pydantic import AfterValidator, BeforeValidator, Field
from torch import Tensor

from nolens.camera import BlackLevel
from nolens.camera.part import refusal
from nolens.camera.psf_set import Depth, depth_um
from nolens.errors import OptionError
from nolens.files import CAMERA_FILE, PSFS_FILE, is_sequence
from nolens.files.formats import READERS
from nolens.jobs.fields import (
    CAMERAS,
    INPUT,
    PICTURE,
    SOLVER,
    AnyPrior,
    Bgr,
    Bin,
    Channels,
    ChosenSupport,
    ChosenTau,
    Dark,
    Detail,
    Device,
    Exposure,
    FieldPoints,
    FilePath,
    Files,
    Flat,
    Flip,
    FullAngle,
    Interval,
    Iterations,
    Name,
    PsfExtent,
    PsfFlip,
    PsfScale,
    RawMosaic,
    White,
    Window,
    check_detail,
    record_beside,
    two_parts,
    window_numbers,
)
from nolens.jobs.options import JobOptions, Option, Written
from nolens.operators import PixelRectangle
from nolens.printable import quoted
from nolens.ranges import Between
from nolens.solvers import Method, Prior, Quality
from nolens.solvers.scene_prior import PHOTO_PRIOR, PRIORS, by_total_variation

FIRST_WEIGHT = (
    "--tau is the weight of the photo by total variation that this prior starts from: --detail 2 "
    "shows more of its own detail, --detail 0.5 less noise"
)
LESS_MEMORY = "a smaller --support or larger pixels (--bin) need less"
_SWEPT: dict[str, tuple[str | None, ...]] = {
    "tau": ("x4", "x2", None, "x0.5", "x0.25"),
    "support": (None, "full", "x1", "x0.75", "x0.5"),
}
"""Factors on the weight, and on the sides of the sensor's frame, in the names of files."""
_SEVERAL = "Several pictures of one frame"
"""Heading of options by which one frame gives more than one picture."""
_MOST_OF_BANDS = 4000
"""Characters of a list of them."""
_UNSWEPT = (Prior.AUTO, Prior.COLOUR_TV)
"""Priors that are another one, or for colours alone."""


def list_of_folder(path: Path) -> Path:
    """A camera's folder stands for its list of PSFs; other folders may be files of many frames."""
    if not path.is_dir() or path.suffix.lower() in READERS:
        return path
    listed = path / PSFS_FILE
    return listed if listed.exists() or not (path / CAMERA_FILE).exists() else path / CAMERA_FILE


_OF_TOTAL_VARIATION = {
    *("method", "tau", "iterations", "tolerance", "low_frequency"),
    *("penalties", "balance", "relaxation"),
}
"""Options of a minimiser, which a trained network has none of."""
_OF_ONE_PICTURE = {
    *("quality", "sweep", "psf_extent", "psf_scale", "psf_flip", "field", "method", "resume"),
    *("low_frequency", "latency", "penalties", "balance", "relaxation", "crop", "tiff_bits"),
    *("frames", "exposure", "flatten", "undistort", "uncertainty"),
}
"""Options that depths or bands, which are solved together, do not have."""
_NOT_OF_BANDS = {
    "mosaic",
    "bgr",
    "channels",
    "bin",
    "prior",
    "flip",
    "depths",
    "noise",
    "depth_smoothness",
    "field_points",
}
BANDS_FILES = {
    "cube": "cube.ome.tif",
    "false colours": "false-colour.png",
    "spectrum": "spectrum.csv",
    "plot of the spectrum": "spectrum.png",
}
"""Files of bands, by what they hold."""


def _as_bands(value: object) -> object:
    """Their number as a text; a text of more than a path has lists too many."""
    if isinstance(value, str) and len(value) > _MOST_OF_BANDS:
        raise refusal("give at most 256 bands, or a .txt that lists them")
    return str(value) if isinstance(value, int) else value


def _split_depths(value: object) -> object:
    """A text such as "8cm,12cm,inf", given once or in parts, as a tuple."""
    texts = (value,) if isinstance(value, str) else value
    if not isinstance(texts, list | tuple) or not all(isinstance(each, str) for each in texts):
        return value
    names = [name.strip() for each in texts for name in each.split(",")]
    return tuple("infinity" if name in ("inf", "infinite") else name for name in names)


def _apart(depths: tuple[Depth, ...]) -> tuple[Depth, ...]:
    if len({depth_um(each) for each in depths}) != len(depths) or len(depths) == 1:
        raise refusal("give two depths or more, each once, such as 8cm,12cm,20cm,inf")
    return depths


_Depths = Annotated[
    tuple[Depth, ...],
    BeforeValidator(_split_depths),
    Field(max_length=1000),
    AfterValidator(_apart),
]
_Places = Annotated[
    tuple[Annotated[int, Between(0, 65535)], Annotated[int, Between(0, 65535)]],
    two_parts("give a row and a column of the picture, from 0, such as 40,60"),
]
_Penalty = Annotated[float, Between(1e-9, 1e9)]


class ReconstructOptions(JobOptions):
    """Reconstruct a photograph from a measurement and a PSF.

    nolens reconstruct raw.dng --psf psf.dng -o out.png

    nolens reconstruct raw.png --psf psf.png --black auto --detail 2 -o out.png -o out.tif

    nolens reconstruct frames/ --psf psf.dng -o pictures

    nolens reconstruct raw.dng --psf mycamera --depths 8cm,12cm,20cm,inf -o volume
    """

    usage = "reconstruct RAW --psf PSF -o out.png (-o again for each further picture)"

    measurement: Annotated[
        FilePath,
        Option(
            "What the sensor measured of the scene: camera raw, .png, .tif, .npy or another file "
            "of docs/formats.md; or a sequence of frames: a folder of such files, a pattern "
            "('raw/*.png'), a .txt that lists them, a file with many (FILE#3 is its third).",
            needed="the measurement (nolens reconstruct RAW --psf PSF -o out.png)",
            role="input",
            positional=True,
            former="measurement",
            label="Raw file",
        ),
    ]
    psf: Annotated[
        FilePath,
        AfterValidator(list_of_folder),
        Option(
            "The point spread function: what the sensor measured of a point source. Kinds of file "
            f"as for measurements; or a camera's folder ({PSFS_FILE}), whose PSFs at several "
            "angles are used together.",
            needed="the point spread function (--psf FILE or FOLDER)",
            role="input",
            label="PSF",
        ),
    ]
    output: Annotated[
        Files,
        Field(min_length=1),
        Option(
            "Picture to write: .png (8-bit sRGB; the 99.5th percentile is white) or .tif (linear); "
            "may be given several times. The record of the run goes beside the first, as .json. "
            "For a sequence, a folder: a .png for every frame, with one white for all. For "
            "--depths, a folder: volume.ome.tif (float), volume.html and sweep.html (pages to turn "
            "it and to go through it), sweep.png, all-in-focus.png, depth.png, depth.tif (mm). "
            "With --frames a video, .mp4, its frames as OME-TIFF, .tif, or side by side, .png.",
            needed="the picture to write (-o out.png)",
            role="output",
            flag="-o",
        ),
    ]
    quality: Annotated[
        Quality | None,
        Option(
            "draft: quick, by the Wiener filter. photo: until the picture no longer changes "
            "visibly. exact: until all relative residuals are below 1e-4; slow.",
            default="photo",
            label="Quality",
        ),
    ] = None
    detail: Detail = 1.0
    depths: Annotated[
        _Depths | None,
        Option(
            "Planes that are solved together, such as 8cm,12cm,20cm,inf: all of the measurement "
            "is the sum of their light. That near objects hide far ones is not modelled. --psf is "
            "a camera's folder, or the PSF of a source at --distance by --camera.",
            _SEVERAL,
            default="one plane",
            label="Depths",
        ),
    ] = None
    bands: Annotated[
        Name | None,
        BeforeValidator(_as_bands),
        Option(
            "Spectrum of every scene pixel, of raw counts through the filters on the sensor's "
            "pixels: how many bands (12), their wavelengths (450nm,475nm,...), a .txt that lists "
            "them; or angles, for polarisers. --psf is the camera's folder.",
            _SEVERAL,
            default="the sensor's colours",
            label="Bands",
        ),
    ] = None
    distance: Annotated[
        Depth | None,
        Option(
            "Of the scene, such as 300mm, or infinity, where --psf is a folder: that of its PSFs "
            "to take. For --depths, of the point source of a single PSF.",
            INPUT,
            default="the only one that the folder has",
            label="Distance of the PSF",
        ),
    ] = None
    field_points: FieldPoints = "auto"
    spectral_smoothness: Annotated[
        float,
        Between(0, 100),
        Option(
            "Weight of differences between neighbouring bands over those between neighbouring "
            "pixels.",
            _SEVERAL,
            label="Spectral smoothness",
        ),
    ] = 0.3
    depth_smoothness: Annotated[
        float,
        Between(0, 100),
        Option(
            "For --depths, weight of differences between neighbouring planes over those between "
            "neighbouring pixels: total variation in 3D, for translucent bodies that are several "
            "planes thick.",
            _SEVERAL,
            label="Depth smoothness",
        ),
    ] = 0.0
    sweep: Annotated[
        Literal["tau", "method", "prior", "support"] | None,
        Option(
            "Also write pictures with other values of an option, and a sheet of them all, "
            "out-sweep.png: tau (the weight of the prior times 4, 2, 1/2, 1/4), method, prior or "
            "support.",
            label="Compare",
        ),
    ] = None
    uncertainty: Annotated[
        Annotated[int, Between(2, 1000)] | None,
        Option(
            "Also write how far each pixel can be trusted, by so many pictures with other noise, "
            "such as 8: out-uncertainty.tif; by how much a trained prior and total variation "
            "disagree, out-uncertainty-difference.tif; and a sheet of both, out-uncertainty.png. "
            "Each takes as long as the picture.",
            PICTURE,
            label="Samples of the uncertainty",
        ),
    ] = None
    frames: Annotated[
        Annotated[int, Between(2, 500)] | None,
        Option(
            "A video of so many frames from one frame of a camera with a rolling shutter, such as "
            "24: --psf is the folder of a camera whose sensor has line_time_us and rolling.",
            _SEVERAL,
            label="Frames of a video",
        ),
    ] = None
    support: ChosenSupport = "auto"
    psf_extent: PsfExtent = "auto"
    dark: Dark = None
    flat: Flat = None
    black: Annotated[
        BlackLevel,
        Option(
            'Black level in counts, which files other than camera raw do not say; or "auto": read '
            "off the PSF's darkest corner.",
            default="what the file says; else that of the darkest corner where it predicts better",
            label="Black level",
        ),
    ] = None
    white: White = None
    mosaic: RawMosaic = None
    bgr: Bgr = False
    channels: Channels = "all"
    bin: Annotated[
        Bin | None,
        Option(
            "Average N×N pixels into one.",
            INPUT,
            default="half of what the PSF carries with draft, a quarter otherwise; 1 beside "
            "a --support or --crop in pixels",
            label="Binning",
        ),
    ] = None
    psf_scale: PsfScale = None
    psf_flip: PsfFlip = "auto"
    field: Annotated[
        FullAngle | None,
        Option(
            "Support of the scene as an angle from side to side, such as 56deg; needs --camera.",
            SOLVER,
            label="Field of view from side to side",
        ),
    ] = None
    camera: Annotated[
        Name | None,
        Option(
            "Tells from where light can come, and is needed for --field, --depths and --flatten "
            f"unless {CAMERA_FILE} lies beside the PSF: {CAMERAS}.",
            SOLVER,
            role="camera",
            label="PSF",
        ),
    ] = None
    method: Annotated[Method, Option("How to solve.", SOLVER, label="Method")] = Method.ADMM
    tau: ChosenTau = "auto"
    prior: AnyPrior = "auto"
    noise: Annotated[
        Literal["auto", "even", "shot", "poisson"],
        Option(
            "For --depths, noise of the pixels: even, more where there is more light (shot), or "
            "Poisson's law itself in place of its variance (poisson). auto: shot where --psf's "
            "folder or --camera describes the sensor, else even.",
            _SEVERAL,
            label="Noise",
        ),
    ] = "auto"
    iterations: Annotated[
        Iterations | None,
        Option(
            "Limit of the iterations; in a sequence, those of a frame after the first.",
            SOLVER,
            default="200; exact 5000; fista 300; in a sequence 8, or 4 turns of a trained prior",
            label="Iterations, at most",
        ),
    ] = None
    tolerance: Annotated[
        Annotated[float, Between(0, 1)] | None,
        Option(
            "Relative residual at which to stop, instead of the preset's rule.",
            SOLVER,
            default="by --quality",
            label="Residual at which to stop",
        ),
    ] = None
    low_frequency: Annotated[
        bool | None,
        Option(
            "Where the scene fills the view, fit its low frequencies with its detail. Without it "
            "they stay behind: faster, and better where the PSF is far from the camera's.",
            SOLVER,
            default="with ADMM",
            former="smooth_part",
            label="Fit low frequencies",
        ),
    ] = None
    resume: Annotated[
        FilePath | None,
        Option(
            "State that an interrupted run left (.state.npz): goes on with it, given the same "
            "files and options.",
            SOLVER,
            role="input",
        ),
    ] = None
    latency: Annotated[
        Interval | None,
        Option(
            "Longest time for a frame of a sequence, such as 200ms.", SOLVER, default="no bound"
        ),
    ] = None
    penalties: Annotated[
        tuple[_Penalty, _Penalty, _Penalty] | None,
        Option("Three penalties of ADMM to start with, as three numbers.", SOLVER),
    ] = None
    balance: Annotated[bool, Option("Balance ADMM's penalties while it runs.", SOLVER)] = True
    relaxation: Annotated[
        Annotated[float, Between(0.01, 1.99)] | None,
        Option(
            "Over-relaxation of ADMM, between 0 and 2.",
            SOLVER,
            default="1.8; 1.5 where the scene fills the view",
        ),
    ] = None
    exposure: Annotated[
        Exposure | None,
        Option(
            "With --frames, the exposure time of a line, such as 1ms.",
            _SEVERAL,
            default="what the frame's file says",
            label="Exposure time of a line",
        ),
    ] = None
    device: Device = "auto"
    crop: Annotated[
        Window | Literal["all"] | None,
        Option(
            "Part of the scene to write, written like --support, or all.",
            PICTURE,
            default="a support that is stated, otherwise the sensor's frame",
            label="Part of the scene to write",
        ),
    ] = None
    spectrum_at: Annotated[
        _Places | None,
        Option(
            "Writes the spectrum at a ROW,COLUMN of the bands, as .csv and plot.",
            _SEVERAL,
            label="Row and column of a spectrum",
        ),
    ] = None
    flatten: Annotated[
        bool,
        Option(
            "Undoes the shading of the lensless camera: the dark towards the corners, by the light "
            "of an even plane (needs the camera: --psf FOLDER or --camera).",
            PICTURE,
            label="Without the camera's shading",
        ),
    ] = False
    undistort: Annotated[
        bool,
        Option(
            "Undoes the distortion by refraction at the layers: straight lines come out straight, "
            "the corners are cut off (needs the camera, as --flatten).",
            PICTURE,
            label="Without the layers' distortion",
        ),
    ] = False
    flip: Flip = "none"
    tiff_bits: Annotated[
        Literal[16, 32], Option("16 (white is 65535) or 32 (radiance as float).", PICTURE)
    ] = 16

    def check_together(self) -> None:
        """Refuse a factor on an automatic τ beside a τ that is stated, and an unfit sweep."""
        check_detail(self.detail, self.tau)
        for name, neutral in (("noise", "auto"), ("depth_smoothness", 0)):
            value = getattr(self, name)
            if self.depths is None and value != neutral:
                option = f"--{name.replace('_', '-')} {value}"
                raise OptionError(f"{option} is for --depths: leave it out")
        if self.depth_smoothness and self.prior == Prior.L1:
            raise OptionError(
                f"--depth-smoothness {self.depth_smoothness:g} weighs a total variation, and "
                "--prior l1 is none: leave one of them out"
            )
        if self.bands is None and self.spectrum_at is not None:
            raise OptionError("--spectrum-at is for --bands: leave it out, or give --bands 12")
        if self.bands is not None:
            self._check_stack("bands (--bands)", _OF_ONE_PICTURE | _NOT_OF_BANDS)
        elif self.depths is not None:
            self._check_stack("planes of several depths (--depths)", _OF_ONE_PICTURE)
        else:
            self._check_sweep()
            self._check_folder()
            self._check_video()

    def _check_video(self) -> None:
        """Refuse what a video from one frame cannot have."""
        if self.frames is None and self.exposure is not None:
            raise OptionError(
                f"--exposure {self.exposure} is for a video from one frame: give --frames, or "
                "leave it out"
            )
        unfit = _OF_ONE_PICTURE - {
            "frames",
            "exposure",
            "psf_extent",
            "psf_scale",
            "psf_flip",
            "field",
        }
        given = sorted(self.model_fields_set & (unfit | {"prior"}))
        if self.frames is not None and (given or self.is_sequence):
            names = " and ".join(f"--{name.replace('_', '-')}" for name in given)
            raise OptionError(
                f"--frames {self.frames} makes a video of one frame, by ADMM with total variation "
                f"in space and time: {f'leave out {names}' if given else 'give one frame (FILE#1)'}"
            )
        if self.frames is not None and self.support == "auto" and self.field is None:
            raise OptionError(
                f"--frames {self.frames}: one frame of a moving scene does not show where its "
                "light comes from. Give --support HEIGHTxWIDTH (nolens simulate prints it), or "
                "--field and --camera; --support full takes light from everywhere"
            )

    def _check_stack(self, what: str, without: set[str]) -> None:
        """Refuse what pictures of one scene have alone, and a file in place of a folder."""
        others = sorted(self.model_fields_set & without)
        if others or self.is_sequence:
            name = f"--{others[0].replace('_', '-')}" if others else f"{self.measurement}"
            raise OptionError(
                f"{name} is not for {what}, of which one frame is solved by ADMM: leave it out"
            )
        if len(self.output) != 1 or self.output[0].suffix:
            raise OptionError(
                f"{what} go into a folder, and given is -o "
                f"{' '.join(str(path) for path in self.output)}: give its name, such as -o stack"
            )

    def _check_sweep(self) -> None:
        sweep, draft = self.sweep, self.quality is Quality.DRAFT
        if self.uncertainty is not None and self.is_sequence:
            raise OptionError(
                f"--uncertainty {self.uncertainty} is of one frame: leave it out for a sequence"
            )
        if sweep is not None and (self.resume is not None or self.is_sequence):
            raise OptionError(
                f"--sweep {sweep} compares pictures of one frame: leave it out for a sequence and "
                "beside --resume"
            )
        if sweep == "method" and (self.quality is not None or self.tau != "auto"):
            raise OptionError(
                "--sweep method compares the solvers, each with a weight of its own: leave out "
                "--quality and --tau"
            )
        if sweep == "prior" and (draft or self.method is Method.WIENER):
            raise OptionError(
                "--sweep prior compares what is assumed of the scene, and the Wiener filter has a "
                "prior of its own: leave out --method wiener and --quality draft"
            )
        if sweep == "tau" and self.tau == 0:
            raise OptionError("--sweep tau multiplies --tau, which is 0: give another, or auto")

    def _check_folder(self) -> None:
        """Refuse what chooses from a folder beside a file, and PSFs that a solver leaves out."""
        several = self.field_points not in ("auto", 1)
        if self.psf_folder is None and (self.distance is not None or several):
            name, given = "distance", str(self.distance)
            if self.distance is None:
                name, given = "field-points", str(self.field_points)
            raise OptionError(
                f"--{name} {given} chooses from a folder, and --psf {self.psf} is one PSF: give a "
                f"camera's folder with a {PSFS_FILE}, or leave it out"
            )
        if several and (self.quality is Quality.DRAFT or self.method is Method.WIENER):
            raise OptionError(
                f"--field-points {self.field_points}: the Wiener filter (draft) takes one PSF. "
                "Leave it out, or choose another --quality or --method"
            )

    @property
    def photo_prior(self) -> str | Path:
        """The prior of a picture: auto is a trained one, unless options speak of a minimiser."""
        minimised = self.is_sequence or self.frames is not None or self._minimiser_options
        return self.prior if minimised or self.prior != Prior.AUTO else PHOTO_PRIOR

    @property
    def _minimiser_options(self) -> list[str]:
        """Options that speak of a minimiser, as the command line has them."""
        fields = type(self).model_fields
        names = [
            name for name in _OF_TOTAL_VARIATION if getattr(self, name) != fields[name].default
        ]
        if self.quality not in (None, Quality.PHOTO):
            names.append("quality")
        if self.sweep == "method":
            names.append("sweep")
        return sorted(f"--{name.replace('_', '-')}" for name in names)

    @property
    def prior_note(self) -> str | None:
        """What options do to the prior of a picture that a person may not expect."""
        filtered = self.method is Method.WIENER or self.quality is Quality.DRAFT
        if self.is_sequence or self.frames is not None or self.resume is not None:
            return None  # Other priors are usual there, or it was said before.
        if self.prior not in tuple(Prior):
            return None if self.tau == "auto" else FIRST_WEIGHT
        if self.prior != Prior.AUTO or filtered:
            return None
        return by_total_variation(self._minimiser_options)

    @property
    def psf_folder(self) -> Path | None:
        """The camera's folder, where `psf` is its list of PSFs."""
        return self.psf.parent if self.psf.name in (PSFS_FILE, CAMERA_FILE) else None

    @property
    def is_sequence(self) -> bool:
        """Whether the measurement is a folder, pattern, list or stack of frames."""
        return is_sequence(self.measurement)

    @property
    def inputs(self) -> dict[str, Path]:
        """Files that are read, by role; the frames of a stack have theirs."""
        files = super().inputs
        files.pop("resume", None)  # A state says what it belongs to.
        if self.is_sequence and not self.measurement.is_dir():
            del files["measurement"]
        return files

    @property
    def bin_by(self) -> int:
        """Sensor pixels along one of the measurement, where none are chosen for it."""
        return 1 if self.bin is None else self.bin

    @property
    def record(self) -> Path:
        """File of the run's record."""
        if self.depths is not None:
            return self.output[0] / "volume.json"
        if self.bands is not None:
            return self.output[0] / "bands.json"
        return record_beside(self.output[0])

    @property
    def state(self) -> Path:
        """File of the state that an interrupted run leaves."""
        return self.output[0].with_suffix(".state.npz")

    @property
    def output_folder(self) -> Path | None:
        """That of a sequence's pictures, or of several depths or bands."""
        together = self.depths is not None or self.bands is not None
        return self.output[0] if self.is_sequence or together else None

    @property
    def written(self) -> tuple[Written, ...]:
        """Pictures and record."""
        if self.depths is not None:
            # Most reconstructions write no stack.
            from nolens.files.stacks import VOLUME_FILES

            names = VOLUME_FILES.items()
            planes = [Written(what, self.output[0] / name) for what, name in names]
            return (*planes, Written("record of the run", self.record))
        if self.bands is not None:
            written = list(BANDS_FILES.items())[: None if self.spectrum_at is not None else 2]
            files = [Written(what, self.output[0] / name) for what, name in written]
            return (*files, Written("record of the run", self.record))
        suffixes = () if self.is_sequence else (".png", ".tif", ".tiff")
        suffixes = suffixes if self.frames is None else (*suffixes, ".mp4")
        pictures = [Written("output", path, suffixes=suffixes) for path in self.output]
        if self.sweep is not None:
            pictures += [
                Written("picture of the sweep", self.swept_path(path, name))
                for name in self.swept_names
                if name is not None
                for path in self.output
            ]
            pictures.append(Written("sheet of the sweep", self.contact_sheet))
        if self.uncertainty is not None:
            values, difference, sheet = self.uncertainty_files
            pictures += [Written("uncertainty", values), Written("sheet of it", sheet)]
            pictures.append(Written("difference from total variation", difference))
        return (*pictures, Written("record of the run", self.record))

    @property
    def swept_names(self) -> tuple[str | None, ...]:
        """Names of a sweep's values in the sheet's order; None for that of these options."""
        if self.sweep == "method":
            return tuple(None if each is self.method else each.value for each in Method)
        if self.sweep == "prior":
            others = [each for each in PRIORS if each not in _UNSWEPT]
            own = [] if self.prior in others else [None]
            return (*own, *(None if each == self.prior else each for each in others))
        return _SWEPT[self.sweep or "tau"]

    def swept_path(self, output: Path, name: str) -> Path:
        """File of a sweep's picture beside an output."""
        return output.with_name(f"{output.stem}-{self.sweep}-{name}{output.suffix}")

    @property
    def uncertainty_files(self) -> tuple[Path, Path, Path]:
        """Of the uncertainty: the spread, what priors disagree by, and a sheet to look at."""
        first = self.output[0]
        stem = f"{first.stem}-uncertainty"
        return (
            first.with_name(f"{stem}.tif"),
            first.with_name(f"{stem}-difference.tif"),
            first.with_name(f"{stem}.png"),
        )

    @property
    def contact_sheet(self) -> Path:
        """File of the sheet of a sweep."""
        return self.output[0].with_name(f"{self.output[0].stem}-sweep.png")


def parse_window(text: str, sensor: tuple[int, int], option: str) -> PixelRectangle:
    """Pixels of HEIGHTxWIDTH, around the middle of the sensor, or of HEIGHTxWIDTH+TOP+LEFT.

    Raises
    ------
    OptionError
        If the text is neither, or a size is zero.
    """
    try:
        height, width, top, left = window_numbers(text)
    except OptionError as error:
        raise OptionError(f"{option} is {quoted(text)}: {error}") from None
    if top is None or left is None:
        return PixelRectangle.centred(height, width, sensor)
    return PixelRectangle(top, left, height, width)


def parse_support(text: str, sensor: tuple[int, int], psf: Tensor) -> PixelRectangle:
    """Pixels that light can come from; by far more than can be seen would only fill the memory.

    Raises
    ------
    OptionError
        If the text is no window, or one larger than can be seen.
    """
    support = parse_window(text, sensor, "--support")
    height, width = sensor[0] + psf.shape[-2], sensor[1] + psf.shape[-1]
    if support.height > height or support.width > width:
        raise OptionError(
            f"--support {text} is larger than what the sensor can see through this PSF; give at "
            f"most {height}x{width}, or full for no limit"
        )
    return support
