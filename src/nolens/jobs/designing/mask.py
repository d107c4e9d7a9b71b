"""A camera with another mask: what all kinds of masks share, and the job that makes one.

A kind is a class of options that derives from `MaskOptions` and makes its mask. It is known by its
name in `MASK_KINDS`, or by an entry point of another package (``nolens.masks``).
"""

import importlib
import math
from abc import abstractmethod
from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass, replace
from functools import partial
from pathlib import Path
from typing import Annotated, Any, ClassVar

import torch

from nolens.camera import LoadedCamera, RandomLenslets, ReliefFile
from nolens.camera.part import PositiveLength
from nolens.design.masks import (
    FREQUENCIES_PER_MM,
    Layout,
    MaskFigures,
    central_psf,
    correlation,
    mask_figures,
    spread_over,
)
from nolens.errors import OptionError
from nolens.files import CAMERA_FILE, camera_files, read_camera, write_camera
from nolens.files.cameras import curve_copies
from nolens.files.plot_design import plot_mask
from nolens.jobs.fields import (
    CAMERAS,
    LIGHTS,
    Device,
    FilePath,
    Name,
    OutputFolderOptions,
    Seed,
    Word,
)
from nolens.jobs.options import Option, Written
from nolens.jobs.run import (
    BYTES_OF_PROGRAM,
    Product,
    Reporter,
    Run,
    Writer,
    check_memory,
    job,
    pick_device,
)
from nolens.optics import surface_bytes
from nolens.plugins import load_plugin, plugin_names
from nolens.printable import quoted
from nolens.quantities import Angle, Length
from nolens.ranges import Between
from nolens.twin import Light, Twin, preview_model, relief_points

MASK_KINDS = {
    "random-lenslets": "mask_lenslets:RandomLensletsMask",
    "lenslet-array": "mask_lenslets:LensletArrayMask",
    "diffuser": "mask_diffuser:DiffuserMask",
    "contour": "mask_contour:ContourMask",
    "optimised": "mask_optimised:OptimisedMask",
}
"""Module, beside this one, and class of each kind; it is loaded where a mask of it is made."""
SmallAngle = Annotated[Angle, Between("0.001 deg", "44.9 deg")]

_RELIEF_FILE, _PICTURE_FILE = "relief.tif", "mask.png"
"""What is written into the camera's folder beside its description."""
_OPTICS, _RESULT = "Camera and light", "Result"
_OVERHANG = Length("1.5", "mm")
_PER_PIXEL = (1, 2, 4)
_CPU = torch.device("cpu")
_PAPERS = RandomLenslets(
    kind="random-lenslets",
    radius=Length("0.67", "mm"),
    pitch=Length("70", "um"),
    smoothing=Length("11", "um"),
    seed=0,
    grid=Length("1.55", "um"),
    overhang=Length("0.5", "mm"),
)
"""The paper's diffuser, as the preset describes it, around a small part of the sensor."""
_MIDDLE_PIXELS = 1152


def mask_kinds() -> tuple[str, ...]:
    """Names of all kinds of masks, those that other packages add last."""
    return tuple(dict.fromkeys((*MASK_KINDS, *plugin_names("nolens.masks"))))


def mask_kind(name: str) -> "type[MaskOptions]":
    """Options of a kind of mask.

    Parameters
    ----------
    name
        A key of `MASK_KINDS`, or the name of an entry point ``nolens.masks`` of another package.

    Raises
    ------
    OptionError
        If there is no such kind, or the package that adds it cannot be loaded.
    """
    if name in MASK_KINDS:
        module, _, attribute = MASK_KINDS[name].partition(":")
        kind = getattr(importlib.import_module(f"{__package__}.{module}"), attribute)
    else:
        kind = load_plugin("nolens.masks", name)
        if kind is None:
            raise OptionError(
                f"there is no kind of mask {quoted(name)}; there are {', '.join(mask_kinds())}"
            )
    if not (isinstance(kind, type) and issubclass(kind, MaskOptions)):
        raise OptionError(
            f"the entry point {name!r} of nolens.masks leads to no class of MaskOptions: mend the "
            "package that has it, or uninstall it"
        )
    return kind


@dataclass(frozen=True)
class MadeMask:
    """A camera with a new mask.

    Parameters
    ----------
    opened
        The camera.
    layout
        Samples of the tile that a designed mask repeats.
    target
        On a mask that was designed for one, the PSF that was wanted, on the cells of the tile.
    stopped
        Whether a person ended the descent early.
    """

    opened: LoadedCamera
    layout: Layout | None = None
    target: torch.Tensor | None = None
    stopped: bool = False


class MaskOptions(OutputFolderOptions):
    """Options that every kind of mask has: a kind derives from it, with fields of its own.

    Attributes
    ----------
    kind
        Its name.
    """

    usage = "design mask KIND -o FOLDER"
    record_file = "mask.json"
    kind: ClassVar[str]

    output: Annotated[
        FilePath,
        Option(
            "Folder of the new camera: camera.toml, relief.tif, mask.png (a picture of relief and "
            "PSF) and mask.json (the record).",
            _RESULT,
            needed="the folder of the new camera (-o folder)",
            role="output",
            flag="-o",
        ),
    ]
    camera: Annotated[
        Name, Option(f"{CAMERAS}: its layers and sensor are kept.", _OPTICS, role="camera")
    ] = "paper"
    light: Annotated[Word, Option(f"{LIGHTS}.", _OPTICS)] = "white-led"
    device: Device = "auto"
    seed: Annotated[Seed, Option("Of what is random.", _RESULT)] = 0
    overhang: Annotated[
        PositiveLength | None,
        Option(
            "How far the mask reaches beyond the sensor.",
            _RESULT,
            default="as in the camera, or 1.5mm",
        ),
    ] = None

    @abstractmethod
    def mask(self, blank: "Blank") -> MadeMask:
        """Make the mask.

        Parameters
        ----------
        blank
            The camera that it is for.

        Raises
        ------
        OptionError
            If there is no such mask, or it is too steep for any grid.
        """

    @property
    def written(self) -> tuple[Written, ...]:
        """Description, relief, picture and record."""
        names = {
            "camera": CAMERA_FILE,
            "relief": _RELIEF_FILE,
            "picture of the mask": _PICTURE_FILE,
        }
        return self.in_folder(names)


@dataclass(frozen=True)
class Blank:
    """A camera that a mask is made for.

    Attributes
    ----------
    opened
        The camera, by its new name, with the mask that it had.
    model
        Its layers and sensor, ready for rays and for estimates.
    light
        That a designed mask is to be good in.
    overhang
        How far the mask reaches beyond the sensor.
    device
        Where to compute.
    reporter
        Is told how far the work is.
    """

    opened: LoadedCamera
    model: Twin
    light: Light
    overhang: Length
    device: torch.device
    reporter: Reporter

    @classmethod
    def of(cls, opened: LoadedCamera, options: MaskOptions, reporter: Reporter) -> "Blank":
        """The camera that a mask is made for, by the options of the mask.

        Raises
        ------
        OptionError
            If the light or the device cannot be used.
        """
        named = opened.camera.model_copy(
            update={"name": f"{opened.camera.name}, {options.kind} mask"}
        )
        relief = opened.camera.mask.relief
        own = relief.overhang if isinstance(relief, RandomLenslets) else _OVERHANG
        return cls(
            replace(opened, camera=named),
            preview_model(opened),
            Light(options.light),
            options.overhang or own,
            pick_device(options.device),
            reporter,
        )

    def size(self, grid_um: float) -> tuple[int, int]:
        """Samples of a relief over sensor and overhang, (rows, columns).

        They are even, so that cells lie as on the sensor.
        """
        sensor, beyond = self.opened.camera.sensor, 2 * self.overhang.um
        rows, columns = (
            2 * math.ceil((count * sensor.pitch.um + beyond) / grid_um / 2)
            for count in (sensor.rows, sensor.columns)
        )
        return rows, columns

    def described(self, relief: Callable[[Length], RandomLenslets], remedy: str) -> MadeMask:
        """The camera with a relief that stays a description.

        Parameters
        ----------
        relief
            Of the distance of its samples: the largest of the pixels' pitch, half and a quarter of
            it that carries the light behind the relief.
        remedy
            What would make it less steep, such as "a smaller --height".

        Raises
        ------
        OptionError
            If it is too steep for all of them.
        """
        return self._on_a_grid(lambda grid: with_relief(self.opened, relief(grid)), remedy)

    def sampled(
        self,
        heights: Callable[[tuple[int, int], float], torch.Tensor],
        remedy: str,
        *,
        margin: Callable[[float], int] = lambda grid_um: 0,
        smaller: str = "--overhang",
    ) -> MadeMask:
        """The camera with a relief of computed heights.

        Parameters
        ----------
        heights
            In um, float32, of so many (rows, columns) and their distance in um; the latter is
            chosen as for `described`.
        remedy
            What would make them less steep, such as "a smaller --height".
        margin
            How many samples of such a distance are computed beside them, on every side.
        smaller
            The options that would have to be smaller to need less memory.

        Raises
        ------
        OptionError
            If they are too steep, or more than the machine has memory for.
        """

        def made(grid: Length) -> LoadedCamera:
            size, beside = self.size(grid.um), 2 * margin(grid.um)
            points = math.prod(count + beside for count in size)
            check_memory(
                BYTES_OF_PROGRAM + surface_bytes(points), _CPU, f"a smaller {smaller} needs less"
            )
            return self.with_heights(heights(size, grid.um), grid)

        return self._on_a_grid(made, remedy)

    def with_heights(self, heights_um: torch.Tensor, grid: Length) -> LoadedCamera:
        """The camera with a relief of these heights."""
        relief = ReliefFile(kind="file", file=_RELIEF_FILE, grid=grid)
        return replace(with_relief(self.opened, relief), relief_um=heights_um)

    def _on_a_grid(self, make: Callable[[Length], LoadedCamera], remedy: str) -> MadeMask:
        pitch = self.opened.camera.sensor.pitch
        for per_pixel in _PER_PIXEL:
            grid = pitch if per_pixel == 1 else Length.of(pitch.um / per_pixel, "um")
            opened = make(grid)
            try:
                preview_model(opened)
                break
            except OptionError as error:
                if per_pixel == _PER_PIXEL[-1]:
                    raise OptionError(
                        f"{error}, and {grid} is the finest that is tried: give {remedy}"
                    ) from None
        return MadeMask(opened)


def with_relief(opened: LoadedCamera, relief: RandomLenslets | ReliefFile) -> LoadedCamera:
    """The camera with another relief, not yet read."""
    mask = opened.camera.mask.model_copy(update={"relief": relief})
    camera = opened.camera.model_copy(update={"mask": mask})
    return replace(opened, camera=camera, relief_um=None)


@job
def design_mask(run: Run[MaskOptions]) -> Product[LoadedCamera]:
    """Design a mask for a camera and write the camera that has it.

    Raises
    ------
    NolensError
        If an option or an output cannot be used; then nothing is written.
    """
    options, reporter, device = run.options, run.reporter, run.device
    opened, light = read_camera(options.camera), Light(options.light)
    run.reads(camera_files(options.camera, opened.camera))
    run.begin()
    made = options.mask(Blank.of(opened, options, reporter))

    reporter.advance("figures", 0.0)
    twin, paper = (_middle(each, device) for each in (made.opened, with_relief(opened, _PAPERS)))
    psf = central_psf(twin, light)
    reporter.advance("figures", 0.6)
    papers_psf = central_psf(paper, light)
    figures, papers = mask_figures(twin, psf), mask_figures(paper, papers_psf)
    summary: dict[str, Any] = {
        "camera": made.opened.camera.name,
        "kind": options.kind,
        "figures": _plain(figures),
        "paper_diffuser": _plain(papers),
        "magnitude_per_mm": list(FREQUENCIES_PER_MM),
        "stop_reason": "interrupted" if made.stopped else "finished",
    }
    if made.layout is not None:
        summary["period_um"] = made.layout.side * made.layout.grid_um
    if made.target is not None:
        target = spread_over(made.target, (psf.shape[1], psf.shape[2]))
        summary["target_correlation"] = [float(correlation(each, target)) for each in psf]
    plot = partial(
        plot_mask,
        heights_um=twin.mask.relief.height_um.cpu(),
        grid_um=twin.mask.relief.grid_um,
        psf=psf,
        papers_psf=papers_psf,
        pixel_um=twin.pixel_um,
        title=made.opened.camera.name,
    )
    more: dict[str, Writer] = {
        **curve_copies(options.camera, opened),
        _PICTURE_FILE: plot,
    }

    def commit(writers: Mapping[Path, Writer]) -> None:
        named = {path.name: write for path, write in writers.items()}
        write_camera(options.output, made.opened.camera, made.opened.relief_um, more=named)

    return Product(
        made.opened,
        summary,
        {options.output / name: write for name, write in more.items()},
        parameters={"kind": options.kind},
        outputs=tuple(each.path for each in options.written if each.path != options.record),
        commit=commit,
    )


def _middle(opened: LoadedCamera, device: torch.device) -> Twin:
    """The camera with the middle of its sensor and no opening, ready to be simulated."""
    sensor = opened.camera.sensor
    rows, columns = (min(_MIDDLE_PIXELS, count) for count in (sensor.rows, sensor.columns))
    small = sensor.model_copy(update={"rows": rows, "columns": columns})
    mask = opened.camera.mask.model_copy(update={"aperture": None})
    camera = opened.camera.model_copy(update={"sensor": small, "mask": mask})
    middle = replace(opened, camera=camera)
    needed = BYTES_OF_PROGRAM + surface_bytes(relief_points(middle))
    check_memory(needed, device, "a smaller --overhang or a larger --pitch needs less")
    return Twin.of(middle, device=device)


def _plain(figures: MaskFigures) -> dict[str, Any]:
    plain = {**asdict(figures), "line_um": figures.line_um}
    return {
        key: None if isinstance(value, float) and math.isnan(value) else value
        for key, value in plain.items()
    }
