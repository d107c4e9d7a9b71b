"""OpenEXR: linear floats, as a PSF, a scene or a truth."""

from contextlib import redirect_stdout
from dataclasses import replace
from io import StringIO
from pathlib import Path

import numpy as np
import OpenEXR

from nolens.camera import Frame
from nolens.errors import FileError
from nolens.files.arrays import frame_from_array
from nolens.files.formats import FrameSequence, refuse_dataset, single
from nolens.files.input import check_bytes, check_size, decoding, quiet_stderr

_FLOAT = 4
_GREY, _COLOURS = ("Y",), ("R", "G", "B")


def open_exr(path: Path, dataset: str | None) -> FrameSequence:
    """Open the channels R, G and B, or Y, of an OpenEXR file.

    Raises
    ------
    FileError
        If a data set is named, which it has none of.
    """
    refuse_dataset(path, dataset)
    return single(path, _read)


def _read(path: Path) -> Frame:
    check_bytes(path)
    with decoding(path, "an OpenEXR file"):
        with quiet_stderr(), OpenEXR.File(str(path), header_only=True) as file:
            for part in file.parts:
                (left, top), (right, bottom) = part.header["dataWindow"]
                size = int(bottom) - int(top) + 1, int(right) - int(left) + 1
                check_size((len(part.header["channels"]), *size), _FLOAT, path)
            kind = file.header()["type"]
        if kind not in (OpenEXR.scanlineimage, OpenEXR.tiledimage):
            raise FileError(f"{path} is a deep picture, with many values for a pixel: flatten it")
        # It prints what is wrong, and then has no channels.
        with (
            quiet_stderr(),
            redirect_stdout(StringIO()),
            OpenEXR.File(str(path), separate_channels=True) as file,
        ):
            there = {name: each.pixels for name, each in file.channels().items()}
    names = next((each for each in (_COLOURS, _GREY) if there.keys() >= set(each)), None)
    if names is None or len({there[name].shape for name in names}) > 1:
        raise FileError(
            f"{path} has the channels {', '.join(sorted(there)) or 'none'}; accepted are R, G and "
            "B, or Y, of one size"
        )
    values = np.stack([there[name] for name in names])
    # 0 is no light: https://openexr.com/en/latest/TechnicalIntroduction.html, "Scene linear".
    return replace(frame_from_array(values, str(path)), black_stated=True)
