"""Fig. 2c: the thickness of the film, and the sharpest of some."""

from dataclasses import replace
from functools import partial
from typing import Any

import torch
from torch import Tensor

from nolens.camera import Camera
from nolens.design.focus import depth_of_focus_um, lenslet_aperture
from nolens.evaluate import pattern_figures
from nolens.files.plot_reproduction import plot_films
from nolens.files.reports import ReportRow
from nolens.jobs.designing.thickness import ThicknessOptions, design_thickness
from nolens.jobs.run import Reporter
from nolens.progress import ProgressCallback, part_of
from nolens.quantities import Length
from nolens.reproduction.comparison import PAPER, Content, Picture, Results, paper_row, section
from nolens.reproduction.setup import ExperimentSetup
from nolens.reproduction.steps import Step, StepResult
from nolens.twin import relief_points

_FILM = {"film": "0.305mm", "film_distance": "0.4mm±0.2mm", "film_material": "polycarbonate"}
"""The paper's master and where it was sharpest; 0.012 inch is assumed for its thickness."""
_REPLICAS = ("pdms", "pua311")
_FILM_OF = "pdms"
_MIDDLE_PIXELS = 96
_PAPERS_WAVELENGTH_UM = 0.5
"""Its depth of focus of 0.41 mm is that of NA 0.035 at 500 nm."""
_BY_RAYS = (
    "radius",
    "radius printed",
    "thickness pdms",
    "± pdms",
    "thickness pua311",
    "± pua311",
    "focal length",
    "aperture",
    "depth of focus",
)


def steps(setup: ExperimentSetup, camera: str) -> tuple[Step, ...]:
    """Radius and thicknesses by rays, and the series of films by waves.

    `camera` is what the setup's camera was read from: its layers are those that the replica lies
    on.
    """
    pixels = _film_pixels(setup)
    films = relief_points(setup.loaded) + len(setup.size.films_mm) * setup.psf_work(pixels)
    return (
        Step(
            "thickness",
            "fig. 2a, b: thickness by ray matrices",
            setup.parameters(**_FILM),
            setup.psf_work(pixels) / len(setup.size.films_mm),
            lambda progress: _designed(camera),
        ),
        Step(
            "films",
            "fig. 2c: films of PDMS",
            setup.parameters(material=_FILM_OF),
            films,
            lambda progress: _films(setup, progress),
        ),
    )


def _designed(camera: str) -> StepResult:
    """What `nolens design thickness` finds from the paper's measurement of its master."""
    options = ThicknessOptions.gather({"camera": camera, **_FILM, "material": _REPLICAS})
    summary = design_thickness(options, Reporter()).summary
    figures: dict[str, Any] = {
        name: summary[name] for name in ("radius_mm", "printed_radius_mm", "film")
    }
    figures["replicas"] = {each["material"]: each for each in summary["materials"]}
    figures["master"] = master_lenslet(
        summary["radius_mm"]["value"], summary["film"]["index"], summary["pitch_um"]["value"]
    )
    return StepResult(figures)


def master_lenslet(radius_mm: float, index: float, pitch_um: float) -> dict[str, float]:
    """Focal length as in air, NA and depth of focus of one lenslet of the master film.

    Parameters
    ----------
    radius_mm
        Radius R of its surface.
    index
        Of the film, n_p.
    pitch_um
        Of the lenslets.
    """
    focal_um = 1e3 * radius_mm / (index - 1)
    aperture = lenslet_aperture(pitch_um, focal_um)
    depth_um = depth_of_focus_um(_PAPERS_WAVELENGTH_UM, aperture)
    return {
        "index": index,
        "focal_length_mm": 1e-3 * focal_um,
        "aperture": float(aperture),
        "depth_of_focus_mm": 1e-3 * float(depth_um),
    }


def with_film(camera: Camera, thickness_mm: float) -> Camera:
    """The camera whose mask is a replica in PDMS of some thickness."""
    place = camera.mask.surface
    film = camera.layers[place].model_copy(
        update={
            "material": _FILM_OF,
            "index": None,
            "thickness": Length.of(round(thickness_mm, 6), "mm"),
        }
    )
    layers = (*camera.layers[:place], film, *camera.layers[place + 1 :])
    return camera.model_copy(update={"layers": layers})


def _films(setup: ExperimentSetup, progress: ProgressCallback) -> StepResult:
    """Width of the autocorrelation of every film's PSF, and the middle of the PSF.

    All colours together count, as the sensor sees the white LED.
    """
    thicknesses = setup.size.films_mm
    widths, middles = [], {}
    for number, thickness_mm in enumerate(thicknesses):
        psf = _psf_behind(setup, thickness_mm, part_of(progress, number, len(thicknesses)))
        widths.append(pattern_figures(psf, setup.experiment.twin.pixel_um).width_um)
        middles[f"psf-{1000 * thickness_mm:.0f}um"] = _middle(psf)[None]
    return StepResult({"thicknesses_mm": list(thicknesses), "widths_um": widths}, middles)


def _psf_behind(setup: ExperimentSetup, thickness_mm: float, progress: ProgressCallback) -> Tensor:
    """PSF behind a film, the sum of all colours."""
    twin = setup.experiment.twin
    camera = with_film(twin.camera, thickness_mm)
    experiment = replace(setup.experiment, twin=replace(twin, camera=camera))
    rows, columns = (count // twin.superpixel for count in _film_pixels(setup))
    return experiment.psf(setup.source, (rows, columns), progress).sum(dim=0)


def _film_pixels(setup: ExperimentSetup) -> tuple[int, int]:
    (rows, columns), (most_rows, most_columns) = setup.size.films_pixels, setup.pixels
    return min(rows, most_rows), min(columns, most_columns)


def _middle(psf: Tensor) -> Tensor:
    """The middle pixels of a PSF, as bright as they are."""
    rows, columns = psf.shape
    size = min(rows, columns, _MIDDLE_PIXELS)
    top, left = (rows - size) // 2, (columns - size) // 2
    return torch.clone(psf[top : top + size, left : left + size])


@section("thickness", "Fig. 2a, b: how thick the replica must be", _BY_RAYS, ("thickness",))
def rays(setup: ExperimentSetup, results: Results) -> Content:
    """Radius and thickness by ray matrices."""
    figures = results["thickness"].figures
    radius, printed = figures["radius_mm"]["value"], figures["printed_radius_mm"]
    replicas: dict[str, Any] = figures["replicas"]
    rows = [
        paper_row(
            "radius",
            radius,
            f"{radius:.3f} mm",
            "Exact ray matrices of eq. 1 for the paper's film at 0.4 mm. It gives no thickness of "
            "the film; 0.305 mm (0.012 inch) is assumed, and 0.1 mm more would add 0.04 mm to R.",
        ),
    ]
    rows.append(
        paper_row(
            "radius printed",
            printed,
            "–" if printed is None else f"{printed:.3f} mm",
            "Eq. 3 as printed has t_g where the matrices give (n_p/n_g)·t_g; that factor is the "
            "1 % between the two.",
        )
    )
    for name in ("pdms", "pua311"):
        exact = replicas[name]["thickness_mm"]
        by_print = replicas[name]["printed_thickness_mm"]
        also = "" if by_print is None else f" With the R of eq. 3 as printed: {by_print:.2f} mm."
        rows += [
            paper_row(
                f"thickness {name}",
                exact["value"],
                f"{exact['value']:.2f} mm",
                f"Eq. 5 from the R above.{also}",
            ),
            paper_row(
                f"± {name}",
                exact["plus_minus"],
                f"{exact['plus_minus']:.2f} mm",
                "From d_p ± 0.2 mm alone, to first order; the paper does not say how it adds up "
                "its own.",
            ),
        ]
    rows += _lenslet(figures["master"], replicas["pua311"])
    return Content(tuple(rows))


def _lenslet(master: dict[str, float], replica: dict[str, Any]) -> list[ReportRow]:
    """Focal length, NA and depth of focus of one lenslet of the master film."""
    focal, aperture = master["focal_length_mm"], master["aperture"]
    depth = master["depth_of_focus_mm"]
    others = {name: replica[name]["value"] for name in ("index", "focal_length_mm", "aperture")}
    return [
        paper_row(
            "focal length",
            focal,
            f"{focal:.2f} mm",
            f"R/(n_p − 1) of the master film, as in air, with n_p = {master['index']:.2f}: that is "
            "what the sentence is about, and the paper rounds it. The replica in PUA 311 "
            f"(n′ = {others['index']:.2f}) has {others['focal_length_mm']:.2f} mm.",
        ),
        paper_row(
            "aperture",
            aperture,
            f"{aperture:.3f}",
            "Half the pitch over the focal length above. With the 1 mm and half of 69.75 µm it is "
            f"0.035. A lenslet of the replica has {others['aperture']:.3f}.",
        ),
        paper_row(
            "depth of focus",
            depth,
            f"{depth:.2f} mm",
            "λ/NA², so it goes with the square of the row above: 0.41 mm is 500 nm / 0.035², and "
            "this is at 500 nm too.",
        ),
    ]


@section(
    "films",
    "Fig. 2c: films of PDMS of several thicknesses",
    ("film", "film width"),
    ("films", "thickness"),
)
def films(setup: ExperimentSetup, results: Results) -> Content:
    """Films of PDMS: how sharp their PSFs are."""
    figures, arrays = results["films"].figures, results["films"].arrays
    widths = dict(zip(figures["thicknesses_mm"], figures["widths_um"], strict=True))
    best_mm = min(widths, key=lambda thickness: widths[thickness])
    exact = results["thickness"].figures["replicas"]["pdms"]["thickness_mm"]
    at_paper = widths.get(PAPER["film"].value or 0.0)
    sharp = [each for each, width in widths.items() if width <= 1.05 * widths[best_mm]]
    beside = "" if at_paper is None else f" At 1.25 mm it is {at_paper:.2f} µm."
    rows = (
        paper_row(
            "film",
            best_mm,
            f"{best_mm:g} mm",
            f"The sharpest of these films; the minimum is flat: from {min(sharp):g} to "
            f"{max(sharp):g} mm the lines are at most 5 % wider, so which of a few films is "
            f"sharpest says little. The paper's own t′ is 1.44 mm, and 1.25 mm was the best of "
            "the films that it made, whose other thicknesses it does not give.",
        ),
        paper_row(
            "film width",
            widths[best_mm],
            f"{widths[best_mm]:.2f} µm",
            f"Without noise, the mean taken off, all directions averaged.{beside} What was said "
            "of the width in fig. 5 holds here, too.",
        ),
    )
    psfs = {thickness: arrays[f"psf-{1000 * thickness:.0f}um"][0] for thickness in widths}
    paper = PAPER["film"].value or 0.0, PAPER["film width"].value or 0.0
    draw = partial(
        plot_films,
        widths_um=widths,
        psfs=psfs,
        predicted_mm=(exact["value"], exact["plus_minus"]),
        paper=paper,
        pixel_um=setup.preview.pixel_um,
    )
    caption = (
        "Above, the middle of the PSF behind films of several thicknesses, each as bright as its "
        "brightest spot; below, the FWHM of the PSF's autocorrelation. The line and the band are "
        "t′ by ray matrices and its ±."
    )
    return Content(rows, (Picture("films", caption, draw, 165.0),))
