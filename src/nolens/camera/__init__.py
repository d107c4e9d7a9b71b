"""What a lensless camera hands over, as plain data: frames, measurements, PSFs and pictures.

A `Frame` is what a file holds (stored counts, colour mosaic, black and white level).
`develop` makes a linear `Measurement` of it, `prepare_psf` makes a point spread function fit
a measurement, and the functions of `picture` turn the radiance that comes out into values a
screen can show. A `Camera` describes one that is to be simulated: its sensor, the layers above
it and its mask; `preset` has some, and TOML text holds any. Nothing in here reads or writes a
file of the user's.
"""

from nolens.camera.curves import AngularCurve, CurveFile, SpectralCurve
from nolens.camera.description import (
    Aperture,
    Camera,
    Flat,
    Layer,
    LoadedCamera,
    Mask,
    RandomLenslets,
    ReliefFile,
)
from nolens.camera.field_psf import FieldPsf
from nolens.camera.filters import FilterArray, Filters, Polariser
from nolens.camera.frame import MOSAICS, Frame
from nolens.camera.materials import MATERIALS, Material, material
from nolens.camera.measurement import BlackLevel, Measurement, black_level, dark_corner, develop
from nolens.camera.psf import Flip, PreparedPsf, PsfGeometry, check_psf, flipped, prepare_psf
from nolens.camera.psf_set import PsfEntry, PsfKind, PsfSet
from nolens.camera.sensor import Package, Sensor
from nolens.camera.shutter import Shutter, developed_rows
from nolens.camera.toml import PRESETS, from_mapping, from_toml, preset, preset_text, to_toml
from nolens.camera.values import arrange_rgb, exposure_white, linear_from_srgb, srgb_from_linear

__all__ = [
    "MATERIALS",
    "MOSAICS",
    "PRESETS",
    "AngularCurve",
    "Aperture",
    "BlackLevel",
    "Camera",
    "CurveFile",
    "FieldPsf",
    "FilterArray",
    "Filters",
    "Flat",
    "Flip",
    "Frame",
    "Layer",
    "LoadedCamera",
    "Mask",
    "Material",
    "Measurement",
    "Package",
    "Polariser",
    "PreparedPsf",
    "PsfEntry",
    "PsfGeometry",
    "PsfKind",
    "PsfSet",
    "RandomLenslets",
    "ReliefFile",
    "Sensor",
    "Shutter",
    "SpectralCurve",
    "arrange_rgb",
    "black_level",
    "check_psf",
    "dark_corner",
    "develop",
    "developed_rows",
    "exposure_white",
    "flipped",
    "from_mapping",
    "from_toml",
    "linear_from_srgb",
    "material",
    "prepare_psf",
    "preset",
    "preset_text",
    "srgb_from_linear",
    "to_toml",
]
