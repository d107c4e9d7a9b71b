"""`nolens reconstruct --bands`: spectra, or linear polarisation, of every scene pixel."""

import math
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
import torch
import torch.nn.functional as nnf
from torch import Tensor

from nolens.camera import Frame, LoadedCamera, Measurement, develop, exposure_white
from nolens.camera.psf_set import depth_um
from nolens.camera.spectra import linear_stokes, spectral_srgb
from nolens.errors import DataError, OptionError
from nolens.experiments.virtual_experiment import VirtualExperiment
from nolens.files import CAMERA_FILE, PSFS_FILE, write_png
from nolens.files.atomic import Writer
from nolens.files.ome import write_ome_tiff
from nolens.files.psf_folder import PsfFolder
from nolens.files.spectra import plot_spectrum, write_spectrum
from nolens.jobs.bands import band_names, parse_bands
from nolens.jobs.reconstruction.options import BANDS_FILES, ReconstructOptions, parse_support
from nolens.jobs.reconstruction.stack import fewer_slices, solve_stack
from nolens.jobs.run import Product, Run
from nolens.machine import BYTES_OF_PROGRAM
from nolens.operators import CroppedConvolution, Geometry, PixelRectangle, StackConvolution
from nolens.optics import PointSource
from nolens.optics.magnification import magnified
from nolens.quantities import Angle, Length
from nolens.solvers import Reconstructor, StackPrior, StackProblem, stack_bytes
from nolens.twin import (
    Band,
    Light,
    Twin,
    distance_um,
    pixel_currents,
    point_spread,
    preview_model,
)

_ITERATIONS, _TOLERANCE = 100, 5e-3
_LIGHT = Light("equal-energy")
"""Of polarised scenes."""
_AROUND = 15
"""Pixels along the square that a pixel's mean light is taken over."""
_HALF, _ALIKE = 0.5, 1e-5
_LESS = "a smaller --support or a camera with fewer pixels need less"
_REMEDY = f"fewer --bands, {_LESS}"


def reconstruct_bands(run: Run[ReconstructOptions]) -> Product[Tensor]:
    """Radiance of every band, (bands, height, width), in one unit for all of them.

    Raises
    ------
    NolensError
        If an input, an option or an output cannot be used; then nothing is written.
    """
    options = run.options
    loaded = run.camera_beside(options.camera, options.psf_folder)
    if loaded is None:
        raise OptionError(
            f"--bands needs what each pixel sees: give a camera's folder with a {CAMERA_FILE} as "
            "--psf, or --camera"
        )
    preview = preview_model(loaded)
    bands = _bands(run, preview)
    measurement = _developed(run, loaded)
    masks = _masks(run, preview, bands)
    psfs = _psfs(run, loaded, preview, bands, measurement.size)
    support = _support(run, measurement, masks, psfs)
    size = measurement.size if support is None else (support.height, support.width)
    if options.spectrum_at is not None:
        row, column = options.spectrum_at
        if not (row < size[0] and column < size[1]):
            raise OptionError(
                f"--spectrum-at {row},{column} lies outside the picture of {size[0]}×{size[1]} "
                "pixels (rows × columns): give a row and a column of it, from 0"
            )
    padded = Geometry.build(measurement.size, (psfs.shape[-2], psfs.shape[-1]), support).padded
    each = stack_bytes(1, 1, padded)
    run.begin(
        BYTES_OF_PROGRAM + len(bands) * each,
        fewer_slices("bands", len(bands), each, run.device, _LESS),
    )
    problem = StackProblem.build(
        StackConvolution(
            [
                CroppedConvolution(psf[None].to(run.device), measurement.size, support)
                for psf in psfs
            ],
            masks.to(run.device),
        ),
        measurement.values.to(run.device),
        valid=measurement.valid.to(run.device),
        variance=_variance(measurement, masks, loaded).to(run.device),
        prior=StackPrior(across=options.spectral_smoothness),
    )

    solved = solve_stack(run, problem, "the bands", iterations=_ITERATIONS, tolerance=_TOLERANCE)
    cube = solved.scene[0]
    figures = {**solved.figures, "bands": [str(band.place) for band in bands]}
    parameters = {**solved.parameters, "camera_description": loaded.camera.model_dump(mode="json")}
    writers = _writers(options, cube, bands)
    return Product(cube, figures, writers, parameters, solved.result.history)


def _bands(run: Run[ReconstructOptions], twin: Twin) -> tuple[Band, ...]:
    """Those of the options; of a number, so many over what the filters pass."""
    options = run.options
    assert options.bands is not None
    if not options.bands.isdecimal():
        return parse_bands(run, options.bands)
    count = int(options.bands)
    if not 2 <= count <= 256:
        raise OptionError(f"--bands {count}: give 2 to 256 bands")
    filters = twin.filters
    if filters is not None and filters.polarisers:
        return tuple(Band(Angle.of(180 * number / count, "deg")) for number in range(count))
    curve = twin.quantum_efficiency if filters is None else filters.behind(twin.quantum_efficiency)
    grid = np.arange(curve.wavelength_nm[0], curve.wavelength_nm[-1] + 0.5)
    seen = np.stack([curve.at(channel, grid) for channel in curve.values]).max(axis=0)
    passed = grid[seen >= _HALF * seen.max()]
    step = (passed[-1] - passed[0]) / count
    places = [round(float(passed[0]) + (number + 0.5) * step, 1) for number in range(count)]
    return tuple(Band(Length.of(place, "nm")) for place in places)


def _masks(run: Run[ReconstructOptions], twin: Twin, bands: tuple[Band, ...]) -> Tensor:
    """What each pixel takes of each band, (bands, rows, columns), at most 1.

    Raises
    ------
    OptionError
        If none takes anything of a band, or all take the same of them.
    """
    name = twin.camera.name
    masks = torch.stack(
        [pixel_currents(twin, band.light(_LIGHT), 1.0, band.polarisation) for band in bands]
    )
    dark = [str(b.place) for b, m in zip(bands, masks, strict=True) if not float(m.max()) > 0]
    if dark:
        raise OptionError(
            f"no pixel of {name!r} sees light of {', '.join(dark)}: leave it out of --bands"
        )
    masks /= masks.max()
    parts = masks / masks.sum(dim=0).clamp_min(1e-9)
    if len(bands) > 1 and float((parts - parts[:, :1, :1]).abs().max()) < _ALIKE:
        raise OptionError(
            f"all pixels of {name!r} see these bands alike, and cannot tell them apart: "
            "wavelengths need spectral filters or a mosaic in camera.toml, angles need polarisers"
        )
    kinds = len(twin.camera.sensor.channels)
    if twin.filters is not None and twin.filters.transmission is not None:
        kinds = len(twin.filters.transmission.values)
    if bands[0].wavelength_nm is not None and len(bands) > kinds:
        run.warn(
            f"{len(bands)} bands through {kinds} kinds of filters: what these cannot tell apart "
            "comes out as smooth as the prior has it"
        )
    return masks


def _developed(run: Run[ReconstructOptions], loaded: LoadedCamera) -> Measurement:
    """The measurement on all pixels of the sensor, each behind its own filter."""
    options = run.options

    def bare(option: str) -> Frame:
        frame = run.frame(option)
        if len(frame.counts) != 1:
            raise DataError(
                f"{frame.source} has the channels {', '.join(frame.channels)}: --bands takes raw "
                "counts of the sensor, one for each pixel"
            )
        black = (sum(frame.black) / len(frame.black),)
        return replace(frame, mosaic=None, channels=("grey",), black=black)

    frame = bare("measurement")
    black = options.black
    if black is None and not frame.black_stated:
        black = loaded.camera.sensor.black_counts
    if black == "auto":
        raise OptionError("--black auto reads off a PSF, and --bands has several: give counts")
    dark, flat = (bare(name) if getattr(options, name) else None for name in ("dark", "flat"))
    measurement = develop(
        frame,
        dark=dark,
        flat=flat,
        black=None if dark is not None else black,
        white=options.white,
    )
    size = loaded.camera.sensor.rows, loaded.camera.sensor.columns
    if measurement.size != size:
        raise DataError(
            f"{options.measurement} has {measurement.size_text} pixels and the sensor of "
            f"{loaded.camera.name!r} {size[0]}×{size[1]}: give a frame of all its pixels"
        )
    return measurement


def _psfs(
    run: Run[ReconstructOptions],
    loaded: LoadedCamera,
    preview: Twin,
    bands: tuple[Band, ...],
    sensor: tuple[int, int],
) -> Tensor:
    """The PSF of each band, measured or of the twin, (bands, rows, columns); one of angles."""
    options = run.options
    wavelengths = [band.wavelength_nm for band in bands]
    if wavelengths[0] is None:
        wavelengths = [None]
    folder = None if options.psf_folder is None else PsfFolder(options.psf_folder)
    if folder is None or folder.psfs:
        return _measured_psfs(run, folder, wavelengths, loaded)
    run.reporter.note("the PSFs of the bands are simulated, as none is listed")
    size = sensor
    if preview.aperture_room_um is None:
        size = 2 * sensor[0], 2 * sensor[1]
    source = PointSource((0.0, 0.0), distance_um(options.distance, loaded))
    lights = [_LIGHT if nm is None else Light(f"{nm:.12g}nm") for nm in wavelengths]
    working = VirtualExperiment(preview, lights[0]).psf_bytes(source, size, pixels=1)
    twin = run.twin(loaded, working, _REMEDY)
    psfs = []
    for number, light in enumerate(lights):
        run.reporter.advance("PSFs", number / len(lights))
        psfs.append(point_spread(twin, source, size, light=light).amax(dim=0).cpu())
    return torch.stack(psfs)


def _measured_psfs(
    run: Run[ReconstructOptions],
    folder: PsfFolder | None,
    wavelengths: list[float | None],
    loaded: LoadedCamera,
) -> Tensor:
    """For each wavelength the PSF of the nearest one that is known; all of the same sum."""
    sensor = loaded.camera.sensor
    superpixel_um = sensor.superpixel * sensor.pitch.um
    frames: dict[float | None, Tensor] = {}
    superpixels = False
    if folder is None:
        frames[None] = run.frame("psf").counts
    else:
        away = None if run.options.distance is None else depth_um(run.options.distance)
        ahead = [each for each in folder.psfs if each.on_axis and each.frame == "chief-ray"]
        ahead = [each for each in ahead if away in (None, each.distance_um)]
        if len({each.distance_um for each in ahead}) != 1:
            have = ", ".join(sorted({str(each.distance) for each in folder.psfs}))
            raise OptionError(
                f"{folder.path} has PSFs of {have}, and one distance straight ahead is needed: say "
                "which (--distance)"
            )
        for each in ahead:
            nm = None if each.wavelength is None else each.wavelength.um * 1e3
            if nm in frames:
                continue
            frames[nm] = folder.frame(each).counts
            if sensor.superpixel > 1 and math.isclose(each.pixel.um, superpixel_um, rel_tol=0.01):
                frames[nm] = _on_all_pixels(frames[nm], each.channels, sensor.mosaic)
                superpixels = True
        run.reads({f"PSF {each.file}": folder.path / each.file for each in ahead})
    known = [nm for nm in frames if nm is not None]
    if not known and wavelengths[0] is not None:
        run.reporter.note("one PSF is known, without a wavelength: it is taken for all bands")
    if superpixels:
        run.reporter.note(
            "the PSFs are of superpixels, and are interpolated to all pixels, each colour from its "
            "own: detail finer than two superpixels is lost. A folder with "
            f"{CAMERA_FILE} and without {PSFS_FILE} has PSFs of all pixels simulated"
        )
    psfs = []
    for nm in wavelengths:
        nearest: float | None = None
        if known and nm is not None:
            nearest = known[int(np.argmin([abs(each - nm) for each in known]))]
        psf = frames.get(nearest, next(iter(frames.values()))).mean(dim=0)
        if psf.shape[0] < sensor.rows or psf.shape[1] < sensor.columns:
            raise DataError(
                f"a PSF has {psf.shape[0]}×{psf.shape[1]} pixels and the sensor {sensor.rows}×"
                f"{sensor.columns}: --bands needs PSFs on all pixels of the sensor, or the folder "
                f"whose {PSFS_FILE} lists those of superpixels. A folder with {CAMERA_FILE} and "
                f"without {PSFS_FILE} has them simulated"
            )
        psfs.append(psf / psf.sum())
    return torch.stack(psfs)


def _on_all_pixels(psf: Tensor, channels: tuple[str, ...], mosaic: str) -> Tensor:
    """A PSF of superpixels, (channels, rows, columns), on all pixels behind a colour mosaic.

    A colour is that of its own pixels in the superpixel, and its values lie there.
    """
    rows, columns = psf.shape[-2:]
    # `magnified` keeps the size.
    wide = nnf.pad(
        psf,
        (columns - columns // 2, columns // 2, rows - rows // 2, rows // 2),
    )
    planes = []
    for plane, channel in zip(wide, channels, strict=True):
        own = [place for place, colour in enumerate(mosaic) if channel in (colour, "grey")]
        moved = [sum(axis) / len(own) for axis in zip(*(divmod(k, 2) for k in own), strict=True)]
        planes.append(magnified(plane, 2.0, moved=(moved[0], moved[1])))
    return torch.stack(planes)


def _support(
    run: Run[ReconstructOptions], measurement: Measurement, masks: Tensor, psfs: Tensor
) -> PixelRectangle | None:
    """Pixels that light can come from; chosen as if all bands were alike."""
    options = run.options
    if options.support == "full":
        return None
    if options.support != "auto":
        return parse_support(options.support, measurement.size, psfs[:1])
    even = measurement.values / masks.mean(dim=0)
    reconstructor = Reconstructor(psfs.mean(dim=0, keepdim=True), tau=1e-4)

    def watch(fraction: float) -> bool:
        return run.reporter.step(
            "% of the choice of the support", round(100 * fraction), 100, "the bands"
        )

    return reconstructor.choose_support(even, measurement.valid, progress=watch).support


def _variance(measurement: Measurement, masks: Tensor, loaded: LoadedCamera) -> Tensor:
    """Of each pixel's noise in counts: photons of the light around it behind its own filter."""

    def around(values: Tensor) -> Tensor:
        return nnf.avg_pool2d(values[None], _AROUND, 1, _AROUND // 2, count_include_pad=False)[0]

    passed = masks.mean(dim=0, keepdim=True)
    light = around(measurement.values) / around(passed) * passed
    light = light.clamp_min(1e-2 * float(light.mean()))
    return loaded.camera.sensor.noise_variance(light)


def _writers(
    options: ReconstructOptions, cube: Tensor, bands: tuple[Band, ...]
) -> dict[Path, Writer]:
    """What writes the files of a cube."""
    names, about = band_names(bands)
    wavelengths = [band.wavelength_nm for band in bands if band.wavelength_nm is not None]
    if wavelengths:
        picture = spectral_srgb(cube, wavelengths)
        stack = cube
    else:
        stack = linear_stokes(cube, [band.polarisation.deg for band in bands if band.polarisation])
        s0, s1, s2 = stack[:3]
        # Through polarisers at 0, 60 and 120 deg.
        turns = [2 * math.pi * number / 3 for number in range(3)]
        picture = torch.stack([s0 + s1 * math.cos(t) + s2 * math.sin(t) for t in turns])
        names, about = ("S0", "S1", "S2", "degree", "angle in deg"), {}
    exposure_white(picture)  # An empty picture is an error before anything is written.
    writers: dict[str, Writer] = {
        "cube": partial(
            write_ome_tiff,
            stack=stack[None],
            axis="T",
            channels=names,
            pixels={},
            about_channels=about,
        ),
        "false colours": partial(write_png, radiance=picture),
    }
    if options.spectrum_at is not None:
        row, column = options.spectrum_at
        values = cube[:, row, column].tolist()
        writers["spectrum"] = partial(write_spectrum, bands=bands, values=values)
        writers["plot of the spectrum"] = partial(
            plot_spectrum, bands=bands, values=values, title=f"row {row}, column {column}"
        )
    return {options.output[0] / BANDS_FILES[what]: write for what, write in writers.items()}
