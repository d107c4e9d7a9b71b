from .atomic import atomic_write, check_folder, check_output, write_into, write_together
from .cameras import (
    CAMERA_FILE,
    PSFS_FILE,
    camera_files,
    read_camera,
    read_material,
    read_psf,
    read_psf_set,
    write_camera,
    write_psfs,
)
from .frames import (
    FRAME_SUFFIXES,
    FrameSequence,
    check_holds,
    describe,
    frame_suffixes,
    is_sequence,
    open_sequence,
    read_frame,
    write_counts,
    write_frame,
)
from .height_maps import HeightMap, read_height_map
from .input import read_text, readable
from .pictures import (
    PICTURE_SUFFIXES,
    Picture,
    check_scans,
    read_picture,
    write_png,
    write_tiff16,
    write_tiff32,
)
from .raw import write_dng
from .record import (
    InputFile,
    RunRecord,
    hash_file,
    read_record,
    versions,
    write_record,
)
from .state import read_state, write_state
from .tolerances import read_tolerances, write_trials
from .write_layout import layout, write_gds, write_oasis
from .write_relief import check_height_map, write_height_map
from .write_solid import write_3mf, write_stl
from .write_step import check_step, write_step

__all__ = [
    "CAMERA_FILE",
    "FRAME_SUFFIXES",
    "PICTURE_SUFFIXES",
    "PSFS_FILE",
    "FrameSequence",
    "HeightMap",
    "InputFile",
    "Picture",
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
    "read_text",
    "read_tolerances",
    "readable",
    "versions",
    "write_3mf",
    "write_camera",
    "write_counts",
    "write_dng",
    "write_frame",
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
