"""Simulated cameras: from a camera's description and a scene to the counts of its sensor."""

from nolens.twin.expose import expose, mosaic, photocurrents, pixel_currents
from nolens.twin.field_model import FieldModel, half_field
from nolens.twin.irradiance import (
    Irradiated,
    check_field_points,
    field_nodes,
    irradiate,
    irradiate_bytes,
)
from nolens.twin.light import LIGHTS, POWER, Band, Light
from nolens.twin.model import (
    LARGEST_ANGLE_DEG,
    REFERENCE_NM,
    Twin,
    camera_figures,
    check_simulation_memory,
    described_lenslets,
    distance_um,
    preview_model,
    relief_points,
    simulation_bytes,
)
from nolens.twin.psf import (
    Frame,
    colours_of,
    point_spread,
    polychromatic_psf,
    polychromatic_psf_bytes,
    shortest_nm,
)
from nolens.twin.rectification import Rectification
from nolens.twin.scene import (
    FieldMap,
    Plane,
    PlaneView,
    acceptance_support,
    in_channels,
    render_planes,
)

__all__ = [
    "LARGEST_ANGLE_DEG",
    "LIGHTS",
    "POWER",
    "REFERENCE_NM",
    "Band",
    "FieldMap",
    "FieldModel",
    "Frame",
    "Irradiated",
    "Light",
    "Plane",
    "PlaneView",
    "Rectification",
    "Twin",
    "acceptance_support",
    "camera_figures",
    "check_field_points",
    "check_simulation_memory",
    "colours_of",
    "described_lenslets",
    "distance_um",
    "expose",
    "field_nodes",
    "half_field",
    "in_channels",
    "irradiate",
    "irradiate_bytes",
    "mosaic",
    "photocurrents",
    "pixel_currents",
    "point_spread",
    "polychromatic_psf",
    "polychromatic_psf_bytes",
    "preview_model",
    "relief_points",
    "render_planes",
    "shortest_nm",
    "simulation_bytes",
]
