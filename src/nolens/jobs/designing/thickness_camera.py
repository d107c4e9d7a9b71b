"""The camera that a design of a replica comes to."""

from collections.abc import Mapping

from nolens.camera import MATERIALS, Camera, Mask, RandomLenslets
from nolens.design.uncertain import Propagated
from nolens.errors import OptionError
from nolens.jobs.designing.thickness_case import Case
from nolens.quantities import Length

_UM_TO_MM = 1e-3


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
