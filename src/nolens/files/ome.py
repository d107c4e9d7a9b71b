"""Stacks of pictures as OME-TIFF, as Fiji, napari and QuPath read them."""

import uuid
from collections.abc import Mapping, Sequence
from hashlib import sha256
from pathlib import Path
from typing import Any, Literal

import numpy as np
import tifffile
from torch import Tensor

from nolens.files.atomic import atomic_write
from nolens.files.tiff import SOFTWARE


def write_ome_tiff(
    path: str | Path,
    stack: Tensor,
    axis: Literal["T", "Z"],
    channels: Sequence[str],
    pixels: Mapping[str, Any],
    about_channels: Mapping[str, Sequence[Any]] | None = None,
) -> None:
    """Write a stack as it is, as 32-bit float OME-TIFF. The same stack gives the same bytes.

    Parameters
    ----------
    stack
        Linear radiance, (slices, channels, height, width).
    axis
        What slices are: times or depths.
    channels
        Their names.
    pixels
        Attributes of OME's element Pixels, such as ``TimeIncrement`` and ``TimeIncrementUnit``
        (https://docs.openmicroscopy.org/ome-model/latest/).
    about_channels
        Attributes of OME's elements Channel, such as ``EmissionWavelength``: a value for each.

    Raises
    ------
    FileError
        If the file cannot be written.
    """
    values = np.ascontiguousarray(stack.cpu().numpy(), np.float32)
    named = {"Name": list(channels), **(about_channels or {})}
    about = {"axes": f"{axis}CYX", "Channel": named, **pixels}
    name = uuid.uuid5(uuid.NAMESPACE_OID, f"{about}{sha256(values.tobytes()).hexdigest()}")
    with atomic_write(path) as temporary:
        tifffile.imwrite(
            temporary,
            values,
            ome=True,
            photometric="minisblack",
            software=SOFTWARE,
            metadata={**about, "UUID": name.urn},
        )
