"""What colour does to a replica: its focus and the width of its lines by wavelength."""

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import torch
from torch import Tensor

from nolens.design.uncertain import Propagated, Uncertain
from nolens.files.plot_thickness import ColourCurves
from nolens.jobs.designing.thickness_case import Case, Medium

_COLOURS_NM = (450.0, 500.0, 550.0, 600.0, 650.0)
_DRAWN_NM = (450.0, 550.0, 650.0)
_DRAWN_STEPS = 201
_UM_TO_MM = 1e-3


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
