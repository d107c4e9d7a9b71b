"""Pictures that notebooks show and NumPy takes."""

import io
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from PIL import Image as Pillow
from torch import Tensor

from nolens.camera import arrange_rgb, exposure_white, srgb_from_linear
from nolens.files import check_output, write_png, write_tiff16


@dataclass(frozen=True, repr=False)
class Image:
    """A linear picture. NumPy takes it as an array, a notebook shows it.

    Parameters
    ----------
    values
        Linear values, ``(channels, height, width)``, float32.
    channels
        Name of every channel: ``("grey",)`` or letters of ``("R", "G", "B")``.
    """

    values: Tensor = field(repr=False)
    channels: tuple[str, ...]

    @property
    def size(self) -> tuple[int, int]:
        """(height, width) in pixels."""
        return self.values.shape[-2], self.values.shape[-1]

    def srgb(self, white: float | None = None) -> NDArray[np.uint8]:
        """8-bit sRGB as ``matplotlib.pyplot.imshow`` takes it, (height, width, 3).

        Parameters
        ----------
        white
            Value that is white; None takes the 99.5th percentile.
        """
        picture = arrange_rgb(self.values, self.channels).cpu()
        encoded = srgb_from_linear(picture / (exposure_white(picture) if white is None else white))
        pixels = encoded.mul(255).round().byte().permute(1, 2, 0)
        array: NDArray[np.uint8] = pixels.expand(-1, -1, 3).contiguous().numpy()
        return array

    def save(self, path: str | Path) -> Path:
        """Write a picture: .png (8-bit sRGB) or .tif (16-bit, linear).

        Raises
        ------
        FileError
            If the suffix is another one, or the file cannot be written.
        """
        path = Path(path)
        check_output(path, (".png", ".tif", ".tiff"))
        picture = arrange_rgb(self.values, self.channels).cpu()
        write = write_png if path.suffix.lower() == ".png" else write_tiff16
        write(path, picture)
        return path

    def __array__(self, dtype: Any = None, copy: bool | None = None) -> NDArray[Any]:
        array: NDArray[Any] = self.values.cpu().numpy()
        return np.array(array, dtype=dtype) if copy or dtype is not None else array

    def _repr_png_(self) -> bytes:
        with io.BytesIO() as stream:
            Pillow.fromarray(self.srgb()).save(stream, "PNG")
            return stream.getvalue()

    def __repr__(self) -> str:
        height, width = self.size
        return f"{type(self).__name__}({height}×{width}, {', '.join(self.channels)})"
