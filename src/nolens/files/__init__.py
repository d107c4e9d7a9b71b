"""Every read and write of a file: camera raw, TIFF, PNG, npy, DNG and run records.

`read_frame` reads what a camera wrote into a `nolens.camera.Frame`, whatever its format; the
writers make pictures, linear TIFFs, DNGs and the record of a run, each by way of a temporary
file, so that a killed run leaves no half file. All that goes wrong is a `FileError` that says
what was found and what would be accepted.
"""

from nolens.files.atomic import atomic_write, check_output, write_together
from nolens.files.describe import describe
from nolens.files.folder import check_folder, write_into
from nolens.files.frames import FrameSequence, is_sequence, open_sequence
from nolens.files.names import readable
from nolens.files.read import SUFFIXES, read_frame
from nolens.files.read_camera import CAMERA_FILE, camera_files, read_camera, write_camera
from nolens.files.read_material import read_material
from nolens.files.read_picture import Picture, read_picture
from nolens.files.read_psfs import PSFS_FILE, read_psf, read_psf_set, write_psfs
from nolens.files.read_relief import HeightMap, read_height_map
from nolens.files.record import (
    InputFile,
    RunRecord,
    hash_file,
    read_record,
    versions,
    write_record,
)
from nolens.files.state import read_state, write_state
from nolens.files.tolerances import read_tolerances, write_trials
from nolens.files.write import write_counts, write_png, write_tiff16, write_tiff32
from nolens.files.write_dng import write_dng
from nolens.files.write_layout import layout, write_gds, write_oasis
from nolens.files.write_relief import check_height_map, write_height_map
from nolens.files.write_solid import write_3mf, write_stl
from nolens.files.write_step import check_step, write_step

__all__ = [
    "CAMERA_FILE",
    "PSFS_FILE",
    "SUFFIXES",
    "FrameSequence",
    "HeightMap",
    "InputFile",
    "Picture",
    "RunRecord",
    "atomic_write",
    "camera_files",
    "check_folder",
    "check_height_map",
    "check_output",
    "check_step",
    "describe",
    "hash_file",
    "is_sequence",
    "layout",
    "open_sequence",
    "read_camera",
    "read_frame",
    "read_height_map",
    "read_material",
    "read_picture",
    "read_psf",
    "read_psf_set",
    "read_record",
    "read_state",
    "read_tolerances",
    "readable",
    "versions",
    "write_3mf",
    "write_camera",
    "write_counts",
    "write_dng",
    "write_gds",
    "write_height_map",
    "write_into",
    "write_oasis",
    "write_png",
    "write_psfs",
    "write_record",
    "write_state",
    "write_step",
    "write_stl",
    "write_tiff16",
    "write_tiff32",
    "write_together",
    "write_trials",
]
