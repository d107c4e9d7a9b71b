"""Bands of scenes as options name them, and scenes that have them."""

from itertools import pairwise
from pathlib import Path
from typing import Any

import torch
from torch import Tensor

from nolens.errors import DataError, NolensError, OptionError
from nolens.files import open_sequence, read_text
from nolens.jobs.run import Run
from nolens.printable import quoted
from nolens.quantities import Angle, Length
from nolens.twin import Band

_MOST = 256
_ACCEPTED = (
    "give wavelengths from 350 to 1100 nm such as 450nm,475nm, or angles of polarisation such as "
    "0deg,45deg,90deg,135deg, each once and in increasing order; or a .txt that lists them"
)


def parse_bands(run: Run[Any], text: str) -> tuple[Band, ...]:
    """Bands of a list such as ``450nm,475nm`` or ``0deg,90deg``, or of a .txt that the run reads.

    Raises
    ------
    NolensError
        If it is no such list.
    """
    listed = text
    if text.lower().endswith(".txt"):
        run.reads({"bands": Path(text)})
        listed = ",".join(read_text(Path(text)).split())
    return bands_of(listed, text)


def bands_of(listed: str, text: str = "") -> tuple[Band, ...]:
    """Bands of a list such as ``450nm,475nm``; `text` is what was given for it.

    Raises
    ------
    OptionError
        If it is no such list.
    """
    text = text or listed
    items = [item for item in listed.split(",") if item.strip()]
    try:
        places = [(Angle if item.strip()[-1] in "g°d" else Length).parse(item) for item in items]
    except NolensError as error:
        raise OptionError(f"--bands is {quoted(text)}: {error}; {_ACCEPTED}") from None
    values = [each.deg if isinstance(each, Angle) else each.um * 1e3 for each in places]
    apart = all(one < other for one, other in pairwise(values))
    wide = isinstance(places[0], Angle) if places else False
    inside = all(wide or 350 <= value <= 1100 for value in values)
    if not (0 < len(places) <= _MOST and apart and inside and len({*map(type, places)}) == 1):
        raise OptionError(f"--bands is {quoted(text)}: {_ACCEPTED}")
    return tuple(Band(each) for each in places)


def read_cube(path: Path, bands: tuple[Band, ...]) -> Tensor:
    """A scene of several bands, linear, (bands, height, width): a file of so many pictures.

    Raises
    ------
    NolensError
        If it cannot be read, or has another number of bands.
    """
    frames = open_sequence(path)
    cube = torch.cat([frames.read(number).counts for number in range(len(frames))])
    if len(cube) != len(bands):
        raise DataError(
            f"{path} has {len(cube)} pictures and there are {len(bands)} bands: give a file with "
            "a picture for each of --bands"
        )
    return cube


def band_names(bands: tuple[Band, ...]) -> tuple[tuple[str, ...], dict[str, Any]]:
    """Names of bands as channels of an OME-TIFF, and the attributes of these (`write_ome_tiff`)."""
    names = tuple(str(each.place) for each in bands)
    if bands[0].wavelength_nm is None:
        return names, {}
    wavelengths = [each.wavelength_nm for each in bands]
    units = ["nm"] * len(bands)
    return names, {"EmissionWavelength": wavelengths, "EmissionWavelengthUnit": units}
