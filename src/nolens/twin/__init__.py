"""Simulated cameras: from a camera's description and a scene to the counts of its sensor."""

from nolens.twin.expose import expose, mosaic, photocurrents
from nolens.twin.field import FieldMap
from nolens.twin.light import LIGHTS, Light
from nolens.twin.measure import Irradiated, check_field_points, irradiate, irradiate_bytes
from nolens.twin.model import LARGEST_ANGLE_DEG, NEAREST_MM, REFERENCE_NM, Twin, described_lenslets
from nolens.twin.plain import PlainModel, aperture_room_um
from nolens.twin.point import colours_of, point_spread
from nolens.twin.scene import Plane, Seen, arrange

__all__ = [
    "LARGEST_ANGLE_DEG",
    "LIGHTS",
    "NEAREST_MM",
    "REFERENCE_NM",
    "FieldMap",
    "Irradiated",
    "Light",
    "PlainModel",
    "Plane",
    "Seen",
    "Twin",
    "aperture_room_um",
    "arrange",
    "check_field_points",
    "colours_of",
    "described_lenslets",
    "expose",
    "irradiate",
    "irradiate_bytes",
    "mosaic",
    "photocurrents",
    "point_spread",
]
