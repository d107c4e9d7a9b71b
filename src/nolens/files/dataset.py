"""Data sets of measurements and truths: shards, their description, and the card."""

import io
import json
import re
import tarfile
from collections.abc import Iterator, Mapping, Sequence
from functools import cache
from pathlib import Path
from types import ModuleType
from typing import Any, Literal, Protocol

import imagecodecs
import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, Field, ValidationError

from nolens.documents import parse_json
from nolens.errors import DataError, FileError, OptionError
from nolens.files.arrays import decode_png
from nolens.files.input import decoding, read_text, system_errors
from nolens.files.parquet import ParquetTable

DATASET_FILE, CARD_FILE, RECIPE_FILE = "dataset.json", "README.md", "recipe.toml"
Layout = Literal["webdataset", "parquet"]
SUFFIXES: Mapping[Layout, str] = {"webdataset": ".tar", "parquet": ".parquet"}
SPLITS = ("train", "validation", "test")
Row = dict[str, Any]
"""An item: its columns by name."""
COLUMNS: Mapping[str, str] = {
    "index": "int64",
    "scene": "string",
    "psf": "string",
    "measurement": "picture",
    "measurement_scale": "float64",
    "measurement_offset": "float64",
    "black_counts": "float64",
    "white_counts": "float64",
    "truth": "picture",
    "truth_scale": "float64",
    "exposure_s": "float64",
    "gain": "float64",
    "read_noise_electrons": "float64",
    "brightest_electrons": "float64",
    "saturated_fraction": "float64",
    "crop": "float64",
    "crop_down": "float64",
    "crop_right": "float64",
    "mirrored": "bool",
    "psf_scale": "float64",
    "psf_rotation_deg": "float64",
    "psf_blur_pixels": "float64",
    "haze": "float64",
    "banding_counts": "float64",
    "black_error_counts": "float64",
    "noise_seed": "int64",
}
"""What each item has; pictures are PNG of 16 bits."""
_PICTURES = tuple(name for name, kind in COLUMNS.items() if kind == "picture")
_ROW_GROUP = 16
"""Items of a Parquet file that are read together."""
_LEVEL = 1
"""Of the compression: noise compresses hardly better with more."""
_LICENCE = re.compile(r"[a-z0-9][a-z0-9.-]*")


class _Part(BaseModel):
    model_config = ConfigDict(frozen=True, extra="forbid")


class DatasetCamera(_Part):
    """A camera: its name, and SHA-256 of the files that describe it, by role."""

    name: str
    sha256: dict[str, str]


class DatasetPsf(_Part):
    """A PSF, and the camera at a distance that it belongs to.

    Attributes
    ----------
    camera
        Number in the list of cameras.
    mask
        0 for the camera's own, otherwise which random one.
    distance
        Of the scenes, such as "300 mm".
    file, response
        Its TIFF, and that of how much light of each scene pixel reaches the sensor, in the folder.
    sha256
        Of the first.
    support
        Height, width, top and left of the truth, in pixels of the sensor's frame.
    mosaic
        Colours of the sensor's superpixel; null for a grey sensor.
    pixel_um
        Distance of the pixels of the truth.
    """

    camera: int
    mask: int
    distance: str
    file: str
    response: str
    sha256: str
    support: tuple[int, int, int, int]
    mosaic: str | None
    pixel_um: float


class DatasetShard(_Part):
    """A file with items, by its name in the folder, how many it has, and its SHA-256."""

    file: str
    items: int
    sha256: str


class DatasetSplit(_Part):
    """The shards of a split, and how many items and scenes they have."""

    items: int
    scenes: int
    shards: tuple[DatasetShard, ...]


class DatasetDescription(_Part):
    """What ``dataset.json`` says of a finished data set.

    Attributes
    ----------
    layout_version
        Of the folder.
    nolens
        Version that made it.
    layout, measurement
        How shards are stored, and whether measurements are raw or developed.
    licence
        Of the scenes, as the person who made it states.
    recipe
        Options that it depends on.
    scenes, scenes_sha256
        How many pictures there are, and a hash of all of them.
    cameras, psfs, splits
        PSFs and splits by their names.
    """

    layout_version: Literal[1] = 1
    nolens: str
    layout: Layout
    measurement: Literal["raw", "developed"]
    licence: str
    recipe: dict[str, Any]
    scenes: int
    scenes_sha256: str
    cameras: tuple[DatasetCamera, ...]
    psfs: dict[str, DatasetPsf]
    splits: dict[Literal["train", "validation", "test"], DatasetSplit] = Field(max_length=3)

    def json_text(self) -> str:
        """Contents of the file."""
        return json.dumps(self.model_dump(mode="json"), indent=2, ensure_ascii=False) + "\n"


def read_dataset(folder: Path) -> DatasetDescription:
    """Read the description of a data set.

    Raises
    ------
    FileError
        If the folder has none, or it is none.
    """
    path = folder / DATASET_FILE
    advice = "Give the folder of a finished data set (nolens dataset make)"
    try:
        return DatasetDescription.model_validate(
            parse_json(read_text(path, "JSON", advice), str(path))
        )
    except (DataError, ValidationError) as error:
        reason = error if isinstance(error, DataError) else error.errors()[0]["msg"]
        raise FileError(f"{path} is no description of a data set ({reason}). {advice}") from None


def encode_picture(array: NDArray[np.uint16]) -> bytes:
    """A PNG of (height, width, 1 or 3)."""
    picture = array[..., 0] if array.shape[-1] == 1 else array
    return bytes(imagecodecs.png_encode(picture, level=_LEVEL))


def decode_picture(data: bytes, source: Path) -> NDArray[np.float32]:
    """Whole numbers of a picture, as (channels, height, width).

    Raises
    ------
    FileError
        If it is damaged.
    """
    return np.ascontiguousarray(np.moveaxis(decode_png(data, source), -1, 0), np.float32)


def check_layout(layout: Layout) -> None:
    """Refuse a layout whose library is not installed.

    Raises
    ------
    OptionError
        If it is not.
    """
    if layout == "parquet":
        _parquet()


def shard_bytes(layout: Layout, rows: Sequence[Row], developed: bool) -> bytes:
    """Contents of a shard.

    Parameters
    ----------
    layout
        How it is stored.
    rows
        Its items.
    developed
        Whether the measurements have three channels.
    """
    stream = io.BytesIO()
    if layout == "webdataset":
        _write_tar(stream, rows)
    else:
        _write_parquet(stream, rows, developed)
    return stream.getvalue()


class Shard(Protocol):
    """A shard that is read by item."""

    def __getitem__(self, place: int) -> Row: ...


def open_shard(path: Path) -> Shard:
    """Open a shard of any layout.

    Raises
    ------
    FileError
        If it is missing or damaged.
    OptionError
        If the library for its layout is not installed.
    """
    if path.suffix == SUFFIXES["parquet"]:
        return _ParquetShard(path)
    return _TarShard(path)


def _write_tar(stream: io.BytesIO, rows: Sequence[Row]) -> None:
    """As WebDataset reads it: files whose names begin with the item's are one item."""
    with tarfile.open(fileobj=stream, mode="w", format=tarfile.USTAR_FORMAT) as tar:
        for row in rows:
            plain = {name: row[name] for name in COLUMNS if name not in _PICTURES}
            text = json.dumps(plain, ensure_ascii=False).encode()
            key = f"{row['index']:08d}"
            for name, data in (
                *((f"{each}.png", row[each]) for each in _PICTURES),
                ("json", text),
            ):
                about = tarfile.TarInfo(f"{key}.{name}")
                about.size = len(data)
                tar.addfile(about, io.BytesIO(data))


class _TarShard:
    def __init__(self, path: Path) -> None:
        self._path = path
        with system_errors(path), decoding(path, "a tar file"), tarfile.open(path, "r:") as tar:
            members = tar.getmembers()
        self._places = [(each.offset_data, each.size) for each in members]
        self._names = [each.name.partition(".")[2] for each in members]

    def __getitem__(self, place: int) -> Row:
        row: Row = {}
        count = len(_PICTURES) + 1
        for number in range(count * place, count * place + count):
            with system_errors(self._path), self._path.open("rb") as file:
                start, size = self._places[number]
                file.seek(start)
                data = file.read(size)
            name = self._names[number]
            if name == "json":
                row |= parse_json(data.decode(), str(self._path))
            else:
                row[name.removesuffix(".png")] = data
        return row


def _write_parquet(stream: io.BytesIO, rows: Sequence[Row], developed: bool) -> None:
    """As `datasets` of Hugging Face reads it: the schema says which columns are pictures."""
    parquet = _parquet()
    import pyarrow as pa

    picture = pa.struct([("bytes", pa.binary()), ("path", pa.string())])
    types = {"picture": picture, "bool": pa.bool_(), "string": pa.string()}
    features: dict[str, Any] = {}
    for name, kind in COLUMNS.items():
        features[name] = {"dtype": kind, "_type": "Value"}
        if kind == "picture":
            # Pillow, which decodes for `datasets`, would drop eight bits of a colour picture.
            features[name] = {"_type": "Image"}
            if developed or name == "truth":
                features[name] = {"decode": False, "_type": "Image"}
    about = json.dumps({"info": {"features": features}})
    schema = pa.schema(
        [(name, types.get(kind) or getattr(pa, kind)()) for name, kind in COLUMNS.items()],
        metadata={"huggingface": about},
    )
    table = pa.table(
        {
            name: [
                {"bytes": row[name], "path": f"{row['index']:08d}.{name}.png"}
                if kind == "picture"
                else row[name]
                for row in rows
            ]
            for name, kind in COLUMNS.items()
        },
        schema=schema,
    )
    parquet.write_table(table, stream, compression="none", row_group_size=_ROW_GROUP)


class _ParquetShard:
    def __init__(self, path: Path) -> None:
        self._table = ParquetTable(path)

    def __getitem__(self, place: int) -> Row:
        row = self._table[place]
        return row | {name: row[name]["bytes"] for name in _PICTURES}


@cache
def _parquet() -> ModuleType:
    try:
        import pyarrow.parquet
    except ImportError:
        raise OptionError(
            "the layout parquet needs pyarrow, which is not installed: pip install "
            "'nolens[parquet]', or take --layout webdataset"
        ) from None
    module: ModuleType = pyarrow.parquet
    return module


def card_text(about: DatasetDescription) -> str:
    """README.md of a data set, whose first lines are those of a Hugging Face data-set card."""
    name = f"Lensless measurements: {', '.join(each.name for each in about.cameras)}"
    count = sum(split.items for split in about.splits.values())
    suffix = SUFFIXES[about.layout]
    return "\n".join(
        [
            "---",
            *_front_matter(name, about, count, suffix),
            "---",
            "",
            f"# {name}",
            "",
            f"{count} simulated measurements of lensless cameras, each with the scene that was "
            f"measured. Made by `nolens dataset make` {about.nolens} from `{RECIPE_FILE}`; every "
            "item can be made again alone (`--items`).",
            "",
            "| split | items | scenes | shards |",
            "|---|---|---|---|",
            *(
                f"| {split} | {each.items} | {each.scenes} | {len(each.shards)} |"
                for split, each in about.splits.items()
            ),
            "",
            "A scene is in one split only.",
            "",
            "## Cameras",
            "",
            "| PSF | camera | mask | distance | truth in pixels |",
            "|---|---|---|---|---|",
            *(
                f"| `{psf}` | {about.cameras[each.camera].name} | "
                f"{'its own' if each.mask == 0 else f'random {each.mask}'} | {each.distance} | "
                f"{each.support[0]}×{each.support[1]} |"
                for psf, each in about.psfs.items()
            ),
            "",
            "SHA-256 of the files that describe them:",
            "",
            *(
                f"- {camera.name}, {role}: `{digest}`"
                for camera in about.cameras
                for role, digest in camera.sha256.items()
            ),
            "",
            "## Recipe",
            "",
            "| option | value |",
            "|---|---|",
            *(f"| {key} | {_value_text(value)} |" for key, value in about.recipe.items()),
            "",
            f"Licence of the scenes, as stated by whoever made this set: {about.licence}.",
            "",
            "## Columns",
            "",
            *_columns(about),
            "",
            "## What it is not for",
            "",
            "- Figures of a real camera: all measurements are simulated. What the recipe does not "
            "vary (dust, stray light, rolling shutter, a sensor's own pattern) is not there.",
            "- Comparison with figures that were measured on other data sets.",
            *(
                ["- What people, animals or texts look like: the scenes are random leaves."]
                if about.recipe.get("scenes") is None
                else ["- Any use that the licence of the scenes does not allow."]
            ),
            "",
        ]
    )


def _front_matter(name: str, about: DatasetDescription, count: int, suffix: str) -> Iterator[str]:
    """YAML; texts as JSON writes them, which is YAML."""
    known = _LICENCE.fullmatch(about.licence) is not None
    yield f"pretty_name: {json.dumps(name)}"
    yield f"license: {about.licence if known else 'other'}"
    if not known:
        yield f"license_name: {json.dumps(about.licence)}"
    yield "task_categories:\n- image-to-image"
    yield "tags:\n- lensless-imaging\n- computational-imaging\n- simulated"
    yield f"size_categories:\n- {_size_category(count)}"
    yield "configs:\n- config_name: default\n  data_files:"
    for split, each in about.splits.items():
        if each.items:
            yield f"  - split: {split}\n    path: data/{split}-*{suffix}"


def _columns(about: DatasetDescription) -> list[str]:
    measured = (
        "counts as the sensor gives them"
        if about.measurement == "raw"
        else "R, G and B of each superpixel, above the stated black level"
    )
    return [
        "Pictures are PNG of 16 bits: value = stored × scale + offset.",
        "",
        f"- `measurement`: {measured} (`measurement_scale`, `measurement_offset`).",
        "- `truth`: linear radiance of the scene on the pixels of the reconstruction, 1 is white "
        "(`truth_scale`).",
        "- `psf`: name of the PSF in `psfs/` that belongs to it (float TIFF, zero shift at height "
        "// 2, width // 2), and of how much light of each scene pixel reaches the sensor "
        "(`…-response.tif`).",
        "- `black_counts`, `white_counts`: stated black level, and the count of a saturated pixel.",
        "- `psf_scale`, `psf_rotation_deg`, `psf_blur_pixels`: how the PSF that made the "
        "measurement differs from the one in `psfs/`; `haze`, `banding_counts`, "
        "`black_error_counts`: further errors.",
        "- the rest: what was drawn for the item.",
    ]


def _size_category(count: int) -> str:
    bounds = (1000, 10_000, 100_000, 1_000_000, 10_000_000)
    names = ("n<1K", "1K<n<10K", "10K<n<100K", "100K<n<1M", "1M<n<10M", "10M<n<100M")
    return names[sum(count >= bound for bound in bounds)]


def _value_text(value: Any) -> str:
    text = ", ".join(map(str, value)) if isinstance(value, list) else str(value)
    return "–" if value is None else text.replace("|", "\\|")
