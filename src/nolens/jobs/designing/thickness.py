"""`nolens design thickness`: how thick a replica must be, with the error of everything."""

import math
from collections.abc import Mapping
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import torch
from torch import Tensor

from nolens.camera import MATERIALS, Camera, Mask, RandomLenslets
from nolens.design.closed_forms import printed_radius_um, replica_thickness_um
from nolens.design.replica import WIDER
from nolens.design.uncertain import Propagated, Uncertain, propagate
from nolens.errors import OptionError
from nolens.files import CAMERA_FILE, camera_files
from nolens.files.cameras import write_description
from nolens.files.plot_thickness import ColourCurves, plot_thickness
from nolens.jobs.designing.thickness_case import Case, Medium
from nolens.jobs.designing.thickness_options import ThicknessOptions
from nolens.jobs.run import Product, Run, Writer, job
from nolens.quantities import Length

_COLOURS_NM = (450.0, 500.0, 550.0, 600.0, 650.0)
_DRAWN_NM = (450.0, 550.0, 650.0)
_DRAWN_STEPS = 201
_UM_TO_MM = 1e-3
_IN_UM = ("line_width",)
_PURE = ("aperture",)


def colours(case: Case, medium: Medium, figures: Mapping[str, Propagated]) -> list[dict[str, Any]]:
    """Focus by wavelength, and how wide the lines are at the thickness for the chosen light.

    Parameters
    ----------
    case
        What is asked.
    medium
        Of the replica.
    figures
        ``radius``, ``thickness`` and its ``room`` in the light that is to be in focus, in um.
    """
    wanted = {f"{each:g} nm": each for each in _COLOURS_NM}
    efficiency = case.opened.quantum_efficiency
    for channel, values in efficiency.values.items():
        total = sum(values)
        if total > 0:
            pairs = zip(efficiency.wavelength_nm, values, strict=True)
            wanted[channel] = sum(nm * value for nm, value in pairs) / total
    rows = []
    for name, nm in wanted.items():
        if not _known(case, medium, nm):
            continue
        thickness, width = _at(case, medium, figures, nm, figures["thickness"].value)
        rows.append(
            {
                "light": name,
                "wavelength_nm": nm,
                "thickness_mm": thickness * _UM_TO_MM,
                "line_width_um": float(width),
            }
        )
    return rows


def curves(case: Case, medium: Medium, figures: Mapping[str, Propagated]) -> ColourCurves:
    """Compute what the plot shows of one replica.

    Parameters
    ----------
    case
        What is asked.
    medium
        Of the replica.
    figures
        ``radius``, ``thickness`` and its ``room`` in the light that is to be in focus, in um.
    """
    thickness, room = figures["thickness"].value, figures["room"].value
    reach = max(2.5 * room, 1.2 * figures["thickness"].plus_minus)
    low = max(0.0, thickness - reach)
    drawn = torch.linspace(low, thickness + reach, _DRAWN_STEPS, dtype=torch.float64)
    first, last = _COLOURS_NM[0], _COLOURS_NM[-1]
    by_colour = [nm for nm in torch.linspace(first, last, 41).tolist() if _known(case, medium, nm)]
    return ColourCurves(
        medium.name,
        thickness * _UM_TO_MM,
        figures["thickness"].plus_minus * _UM_TO_MM,
        (max(0.0, thickness - room) * _UM_TO_MM, (thickness + room) * _UM_TO_MM),
        tuple((nm, _at(case, medium, figures, nm, thickness)[0] * _UM_TO_MM) for nm in by_colour),
        tuple((drawn * _UM_TO_MM).tolist()),
        {
            nm: tuple(_at(case, medium, figures, nm, drawn)[1].tolist())
            for nm in _DRAWN_NM
            if _known(case, medium, nm)
        },
    )


def _at(
    case: Case,
    medium: Medium,
    figures: Mapping[str, Propagated],
    wavelength_nm: float,
    thickness_um: float | Tensor,
) -> tuple[float, Tensor]:
    """Thickness in focus in another light, and width of the lines behind given ones.

    The master is the same: its radius is that found in the light it was measured in.
    """
    values = {
        name: torch.tensor(each.value, dtype=torch.float64)
        for name, each in case.inputs(wavelength_nm, medium).items()
    }
    known = replace(case, film=None, radius=Uncertain(figures["radius"].value))
    values["radius"] = torch.tensor(figures["radius"].value, dtype=torch.float64)
    replica = known.replica_of(values)
    width = replica.width_um(thickness_um, wavelength_nm * 1e-3, values["pitch"], case.rounding)
    return float(replica.thickness_um), width


def _known(case: Case, medium: Medium, wavelength_nm: float) -> bool:
    """Whether the indices of all that the replica needs are known at a wavelength."""
    media = [medium, *(layer.medium for layer in case.cover)]
    ranges = [each.material.range_nm for each in media if each.material is not None]
    return all(low <= wavelength_nm <= high for low, high in ranges)


def with_replica(case: Case, figures: Mapping[str, Propagated]) -> Camera:
    """Give the camera its first replica, of the computed thickness, as its mask.

    Parameters
    ----------
    case
        Has the camera.
    figures
        ``radius`` and ``thickness`` of the replica, in um.

    Raises
    ------
    OptionError
        If the camera's relief is not one of lenslets of one radius.
    """
    camera, medium = case.opened.camera, case.replicas[0]
    relief = camera.mask.relief
    if not isinstance(relief, RandomLenslets):
        raise OptionError(
            f"the relief of {camera.name!r} is of kind {relief.kind}, which no radius describes: "
            "leave -o out and write the thickness into a copy of its camera.toml"
        )
    pitch_um = case.pitch.value
    radius_mm = figures["radius"].value * _UM_TO_MM
    lenslets = relief.model_copy(
        update={
            "radius": Length.of(round(radius_mm, 4), "mm"),
            "pitch": Length.of(pitch_um, "um"),
            "smoothing": Length.of(round(case.rounding * pitch_um, 6), "um"),
        }
    )
    layers = [medium.layer("resin", round(figures["thickness"].value, 1))]
    layers += [
        layer.medium.layer(layer.name, layer.thickness.value)
        for layer in case.cover
        if layer.thickness.value > 0
    ]
    media = [medium, *(layer.medium for layer in case.cover)]
    own = {each.material.name: each.material for each in media if each.material is not None}
    sensor = camera.sensor.model_copy(
        update={
            "quantum_efficiency": case.opened.quantum_efficiency,
            "acceptance": case.opened.acceptance,
        }
    )
    return camera.model_copy(
        update={
            "name": f"{camera.name}, {medium.name}",
            "note": f"{camera.note} The thickness of the resin is that of nolens design "
            f"thickness for {case.options.wavelength}.".strip(),
            "layers": tuple(layers),
            "materials": tuple(each for name, each in own.items() if name not in MATERIALS),
            "sensor": sensor,
            "mask": Mask(surface=0, relief=lenslets, aperture=camera.mask.aperture),
        }
    )


def thickness_figures(case: Case) -> tuple[list[dict[str, Propagated]], dict[str, Any]]:
    """Figures of every replica, with their ±, and all of them in values that JSON has.

    Raises
    ------
    OptionError
        If a material cannot focus on this sensor.
    """
    case.check()
    found = [_figures(case, medium) for medium in case.replicas]
    source_um = case.options.source_um
    return found, {
        "camera": case.opened.camera.name,
        "wavelength_nm": case.options.wavelength.nm,
        "distance_mm": None if math.isinf(source_um) else source_um * _UM_TO_MM,
        **_given(case),
        "radius_mm": _told(found[0]["radius"], _UM_TO_MM),
        "printed_radius_mm": _printed(case),
        "materials": [
            _material(case, medium, figures)
            for medium, figures in zip(case.replicas, found, strict=True)
        ],
    }


@job
def design_thickness(run: Run[ThicknessOptions]) -> Product[list[dict[str, Propagated]]]:
    """Find the thickness of each replica, and write what was asked for.

    Raises
    ------
    NolensError
        If an input or an option cannot be used, or a material cannot focus on this sensor; then
        nothing is written.
    """
    options = run.options
    case = Case.of(options)
    run.reads(camera_files(options.camera, case.opened.camera))
    run.begin()
    found, summary = thickness_figures(case)
    writers: dict[Path, Writer] = {}
    if options.plot is not None:
        drawn = [
            curves(case, medium, figures)
            for medium, figures in zip(case.replicas, found, strict=True)
        ]
        writers[options.plot] = partial(plot_thickness, materials=drawn)
    if options.output is not None:
        camera = with_replica(case, found[0])
        writers[options.output / CAMERA_FILE] = partial(write_description, camera=camera)
    return Product(found, summary, writers)


def _figures(case: Case, medium: Medium) -> dict[str, Propagated]:
    """All figures of one replica with their ±, in um, and the radius."""
    wavelength_nm = case.options.wavelength.nm
    inputs = case.inputs(wavelength_nm, medium)
    nominal = {name: torch.tensor(each.value, dtype=torch.float64) for name, each in inputs.items()}
    case.replica_of(nominal).check(medium.name, wavelength_nm)

    def results(values: Mapping[str, Tensor]) -> dict[str, Tensor]:
        replica = case.replica_of(values)
        radius = torch.as_tensor(replica.radius_um, dtype=torch.float64)
        figures = replica.figures(wavelength_nm * 1e-3, values["pitch"], case.rounding)
        return {"radius": radius, **figures}

    return propagate(inputs, results)


def _material(case: Case, medium: Medium, figures: dict[str, Propagated]) -> dict[str, Any]:
    """Figures of one replica, in values that JSON has."""
    told: dict[str, Any] = {
        "material": medium.name,
        "index": _told(_plain(medium.at(case.options.wavelength.nm)), 1.0),
    }
    for name, figure in figures.items():
        if name == "radius":
            continue
        unit, scale = ("_mm", _UM_TO_MM)
        if name in _IN_UM:
            unit, scale = "_um", 1.0
        elif name in _PURE:
            unit, scale = "", 1.0
        told[f"{name}{unit}"] = _told(figure, scale)
    thickness, room = figures["thickness"].value, figures["room"].value
    told["sharp_mm"] = [max(0.0, thickness - room) * _UM_TO_MM, (thickness + room) * _UM_TO_MM]
    told["sharp_means"] = f"lines at most {100 * (WIDER - 1):.0f} % wider than in focus"
    printed = _printed(case)
    told["printed_thickness_mm"] = None
    if printed is not None:
        told["printed_thickness_mm"] = _printed_thickness(case, medium, printed)
    told["colours"] = colours(case, medium, figures)
    return told


def _given(case: Case) -> dict[str, Any]:
    """Film and cover as they were taken."""
    wavelength_nm = case.options.wavelength.nm
    film = None
    if case.film is not None:
        medium, thickness, distance = case.film
        film = {
            "material": medium.name,
            "index": medium.at(wavelength_nm).value,
            "thickness_mm": _told(_plain(thickness), _UM_TO_MM),
            "distance_mm": _told(_plain(distance), _UM_TO_MM),
            "side": case.options.film_side or "scene",
            "assumed": case.options.film is None and case.options.film_distance is None,
        }
    cover = [
        {
            "name": layer.name,
            "material": layer.medium.name,
            "index": layer.medium.at(wavelength_nm).value,
            "thickness_mm": _told(_plain(layer.thickness), _UM_TO_MM),
        }
        for layer in case.cover
    ]
    return {"film": film, "cover": cover, "pitch_um": _told(_plain(case.pitch), 1.0)}


def _printed(case: Case) -> float | None:
    """Radius in mm by the paper's eq. 3 as printed, where that is about a camera like this."""
    names = tuple(layer.name for layer in case.cover)
    scene = (case.options.film_side or "scene") == "scene"
    if case.film is None or names != ("glass", "gap") or not scene:
        return None
    if not math.isinf(case.options.source_um):
        return None
    medium, thickness, distance = case.film
    index = medium.at(case.options.wavelength.nm).value
    glass, gap = (layer.thickness.value for layer in case.cover)
    radius_um = printed_radius_um(thickness.value, index, distance.value, glass, gap)
    return float(radius_um) * _UM_TO_MM


def _printed_thickness(case: Case, medium: Medium, radius_mm: float) -> float:
    """Thickness in mm by eq. 5 from that radius."""
    wavelength_nm = case.options.wavelength.nm
    glass, gap = case.cover
    thickness_um = replica_thickness_um(
        radius_mm / _UM_TO_MM,
        medium.at(wavelength_nm).value,
        glass.thickness.value,
        glass.medium.at(wavelength_nm).value,
        gap.thickness.value,
    )
    return float(thickness_um) * _UM_TO_MM


def _plain(given: Uncertain) -> Propagated:
    return Propagated(given.value, given.plus_minus, {})


def _told(figure: Propagated, scale: float) -> dict[str, Any]:
    """A figure in the unit it is told in, and what its ± is made of."""
    told: dict[str, Any] = {
        "value": figure.value * scale,
        "plus_minus": figure.plus_minus * scale,
    }
    if figure.parts:
        told["parts"] = {name: part * scale for name, part in figure.parts.items()}
        told["shares"] = figure.shares
    return told
