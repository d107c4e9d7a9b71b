"""Fig. 2: how thick a replica must be, by ray matrices, and how sharp films of PDMS are."""

from dataclasses import replace
from typing import Any

import torch
from torch import Tensor

from nolens.camera import Camera
from nolens.design.focus import depth_of_focus_um, lenslet_aperture
from nolens.evaluate import pattern_figures
from nolens.experiments.virtual_experiment import VirtualExperiment
from nolens.jobs.designing.thickness import design_thickness
from nolens.jobs.designing.thickness_options import ThicknessOptions
from nolens.quantities import Length
from nolens.reproduction.steps import Found, Step, Tick, within
from nolens.reproduction.workbench import SECONDS_OF_RELIEF, Workbench

_FILM = {"film": "0.305mm", "film_distance": "0.4mm±0.2mm", "film_material": "polycarbonate"}
"""The paper's master and where it was sharpest; 0.012 inch is assumed for its thickness."""
_REPLICAS = ("pdms", "pua311")
_FILM_OF = "pdms"
_SHOWN_CELLS = 96
_PAPERS_WAVELENGTH_UM = 0.5
"""Its depth of focus of 0.41 mm is that of NA 0.035 at 500 nm."""


def steps(work: Workbench, camera: str) -> tuple[Step, ...]:
    """Radius and thicknesses by rays, and the series of films by waves.

    Parameters
    ----------
    work
        The camera.
    camera
        What it was read from: its layers are those that the replica lies on.
    """
    pixels = _film_pixels(work)
    seconds = SECONDS_OF_RELIEF + len(work.size.films_mm) * work.psf_seconds(pixels)
    return (
        Step(
            "thickness",
            "fig. 2a, b: thickness by ray matrices",
            work.parameters(**_FILM),
            1.0,
            lambda tick: _designed(camera),
        ),
        Step(
            "films",
            "fig. 2c: films of PDMS",
            work.parameters(material=_FILM_OF),
            seconds,
            lambda tick: _films(work, tick),
        ),
    )


def _designed(camera: str) -> Found:
    """What `nolens design thickness` finds from the paper's measurement of its master."""
    given = {"camera": camera, **_FILM, "material": _REPLICAS}
    summary = design_thickness(ThicknessOptions.gather(given)).summary
    figures: dict[str, Any] = {
        name: summary[name] for name in ("radius_mm", "printed_radius_mm", "film")
    }
    figures["replicas"] = {found["material"]: found for found in summary["materials"]}
    figures["master"] = master_lenslet(
        summary["radius_mm"]["value"], summary["film"]["index"], summary["pitch_um"]["value"]
    )
    return Found(figures)


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


def _films(work: Workbench, tick: Tick) -> Found:
    """Width of the autocorrelation of every film's PSF, and the middle of the PSF.

    All colours together count, as the sensor sees the white LED.
    """
    thicknesses = work.size.films_mm
    widths, shown = [], {}
    for number, thickness_mm in enumerate(thicknesses):
        psf = _behind(work, thickness_mm, number / len(thicknesses), tick)
        widths.append(pattern_figures(psf, work.bench.twin.cell_um).width_um)
        shown[f"psf-{1000 * thickness_mm:.0f}um"] = _middle(psf)[None]
    return Found({"thicknesses_mm": list(thicknesses), "widths_um": widths}, shown)


def _behind(work: Workbench, thickness_mm: float, before: float, tick: Tick) -> Tensor:
    """PSF behind a film, the sum of all colours."""
    twin = work.bench.twin
    camera = with_film(twin.camera, thickness_mm)
    bench: VirtualExperiment = replace(work.bench, twin=replace(twin, camera=camera))
    cells = tuple(count // twin.cell_pixels for count in _film_pixels(work))
    part = within(tick, before, 1 / len(work.size.films_mm))
    return bench.psf(work.source, (cells[0], cells[1]), part).sum(dim=0)


def _film_pixels(work: Workbench) -> tuple[int, int]:
    wanted = zip(work.size.films_pixels, work.pixels, strict=True)
    rows, columns = (min(pair) for pair in wanted)
    return rows, columns


def _middle(psf: Tensor) -> Tensor:
    """The middle cells, as bright as they are, of a PSF."""
    rows, columns = psf.shape
    size = min(rows, columns, _SHOWN_CELLS)
    top, left = (rows - size) // 2, (columns - size) // 2
    return torch.clone(psf[top : top + size, left : left + size])
