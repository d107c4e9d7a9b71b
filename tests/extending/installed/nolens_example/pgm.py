"""Binary graymaps of Netpbm (P5), as microscopes and older cameras write them."""

import re
from pathlib import Path

import numpy as np
import torch

from nolens.camera import Frame
from nolens.files.input import check_size

_HEADER = re.compile(rb"P5\s+(\d{1,9})\s+(\d{1,9})\s+(\d{1,9})\s")


def read_pgm(path: Path) -> Frame:
    """Stored counts of a .pgm file of 8 or 16 bits."""
    data = path.read_bytes()
    header = _HEADER.match(data)
    if header is None:
        raise ValueError("it has no header P5 WIDTH HEIGHT WHITE")
    width, height, white = (int(each) for each in header.groups())
    stored = np.dtype(">u2" if white > 255 else "u1")
    check_size((height, width), stored.itemsize, path)
    if len(data) - header.end() != width * height * stored.itemsize:
        raise ValueError(f"{height}×{width} pixels are said, and others are there")
    counts = np.frombuffer(data, stored, offset=header.end()).reshape(1, height, width)
    return Frame(
        counts=torch.from_numpy(counts.astype(np.float32)),
        channels=("grey",),
        mosaic=None,
        black=(0.0,),
        white=float(white),
        stored_as=stored.name,
        source=str(path),
    )
