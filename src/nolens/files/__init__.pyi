from .atomic import atomic_write, check_folder, check_output, write_into, write_together
from .cameras import (
    CAMERA_FILE,
    PSFS_FILE,
    camera_files,
    read_camera,
    read_light,
    read_material,
    read_psf,
    read_psf_set,
    write_camera,
    write_psfs,
)
from .formats import Address, FrameSequence, frame_suffixes
from .frames import FRAME_SUFFIXES, check_holds, describe, read_frame, write_frame
from .height_maps import HeightMap, read_height_map
from .input import read_text, readable
from .pictures import (
    PICTURE_SUFFIXES,
    check_scans,
    read_picture,
    write_png,
    write_tiff16,
    write_tiff32,
)
from .raw import write_dng
from .record import InputFile, RunRecord, read_record, versions, with_former_keys, write_record
from .sequences import is_sequence, open_sequence
from .state import read_state, write_state
from .tolerances import read_tolerances, write_trials
from .workshop import check_height_map, check_step, workpiece_writers

__all__ = [
    "CAMERA_FILE",
    "FRAME_SUFFIXES",
    "PICTURE_SUFFIXES",
    "PSFS_FILE",
    "Address",
    "FrameSequence",
    "HeightMap",
    "InputFile",
    "RunRecord",
    "atomic_write",
    "camera_files",
    "check_folder",
    "check_height_map",
    "check_holds",
    "check_output",
    "check_scans",
    "check_step",
    "describe",
    "frame_suffixes",
    "is_sequence",
    "open_sequence",
    "read_camera",
    "read_frame",
    "read_height_map",
    "read_light",
    "read_material",
    "read_picture",
    "read_psf",
    "read_psf_set",
    "read_record",
    "read_state",
    "read_text",
    "read_tolerances",
    "readable",
    "versions",
    "with_former_keys",
    "workpiece_writers",
    "write_camera",
    "write_dng",
    "write_frame",
    "write_into",
    "write_png",
    "write_psfs",
    "write_record",
    "write_state",
    "write_tiff16",
    "write_tiff32",
    "write_together",
    "write_trials",
]
