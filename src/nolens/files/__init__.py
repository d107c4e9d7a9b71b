"""Every read and write of a file: camera raw, TIFF, PNG, npy, DNG and run records.

`read_frame` reads what a camera wrote into a `nolens.camera.Frame`, whatever its format; the
writers make pictures, linear TIFFs, DNGs and the record of a run, each by way of a temporary
file, so that a killed run leaves no half file. All that goes wrong is a `FileError` that says
what was found and what would be accepted.
"""

from nolens.files.atomic import atomic_write, check_output, write_together
from nolens.files.describe import describe
from nolens.files.names import readable
from nolens.files.read import SUFFIXES, read_frame
from nolens.files.read_camera import CAMERA_FILE, camera_files, read_camera, write_camera
from nolens.files.read_picture import Picture, read_picture
from nolens.files.record import InputFile, RunRecord, hash_file, versions, write_record
from nolens.files.write import write_counts, write_png, write_tiff16, write_tiff32
from nolens.files.write_dng import write_dng

__all__ = [
    "CAMERA_FILE",
    "SUFFIXES",
    "InputFile",
    "Picture",
    "RunRecord",
    "atomic_write",
    "camera_files",
    "check_output",
    "describe",
    "hash_file",
    "read_camera",
    "read_frame",
    "read_picture",
    "readable",
    "versions",
    "write_camera",
    "write_counts",
    "write_dng",
    "write_png",
    "write_record",
    "write_tiff16",
    "write_tiff32",
    "write_together",
]
