"""What the installed command says of wrong and odd files, or makes of them: `docs/odd-inputs.md`.

`make bench-odd` (`python bench/odd_inputs.py`) takes a photograph and a point source with a
simulated camera, spoils the two files in one way after the other, and gives each pair to `nolens
reconstruct` without any option but its files. A picture is right where its PSNR is within 0.5 dB
of that of the unspoilt files. Other files have to be named: by an error, with which nothing is
written, by a warning, or by a note where it is stated which (a grey PSF). `--kinds` takes a part of
them and writes no page, which also has what `bench/alarms.py` printed into the file `--alarms`.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
import tempfile
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
import tifffile
import torch
import torch.nn.functional as nnf
from numpy.typing import NDArray
from PIL import Image
from torch import Tensor

import nolens as nl
from nolens.amounts import amount
from nolens.camera import Frame, develop
from nolens.camera.values import srgb_from_linear
from nolens.files import write_frame
from nolens.operators import PixelRectangle
from nolens.optics.magnification import magnified
from shots import taken

NOLENS = Path(sys.executable).with_name("nolens")
PIXELS = (512, 640)
"""Rows and columns of the sensor that are read: superpixels are half of them."""
PHOTOGRAPH, ANGLE = "astronaut", "20deg"
BLACK, WHITE = 256.0, 4095.0
RIGHT_DB = 0.5


@dataclass(frozen=True)
class Pair:
    """Counts of a measurement and of its PSF, (channels, height, width), and the scene."""

    raw: Tensor
    point: Tensor
    truth: Tensor
    support: PixelRectangle
    shot: nl.SimulatedMeasurement = field(repr=False)
    point_frame: Frame = field(repr=False)

    @classmethod
    def of(cls, camera: nl.Camera, angle: str = ANGLE) -> Pair:
        """In the colours of a camera."""
        shot = taken(camera, PHOTOGRAPH, angle=angle)
        point = nl.simulate_point(camera, wavelengths=1)
        raw, psf = (develop(each).values + BLACK for each in (shot.frame, point))
        return cls(raw, psf, shot.expected, shot.support, shot, point)

    @property
    def green(self) -> Pair:
        """Of green alone."""
        return replace(self, raw=self.raw[1:2], point=self.point[1:2], truth=self.truth[1:2])


@dataclass(frozen=True)
class Files:
    """Where to write the two files of a run."""

    folder: Path

    def stated(self, name: str, counts: Tensor) -> Path:
        """Counts of one channel as a TIFF that says black and white."""
        frame = Frame(
            counts.round().clamp(0, WHITE), ("grey",), None, (BLACK,), WHITE, "uint16", name,
            black_stated=True,
        )  # fmt: skip
        write_frame(self.folder / f"{name}.tif", frame)
        return self.folder / f"{name}.tif"

    def plain(self, name: str, counts: Tensor, **options: Any) -> Path:
        """Counts as a TIFF that says nothing; three or four channels are colours."""
        bits = options.pop("bits", 16)
        values = counts.round().clamp(0, 2**bits - 1).numpy().astype(f"uint{bits}")
        path = self.folder / f"{name}.tif"
        if len(values) == 1:
            tifffile.imwrite(path, values[0], **options)
        else:
            tifffile.imwrite(path, values.transpose(1, 2, 0), photometric="rgb", **options)
        return path

    def raw(self, name: str, frame: Frame) -> Path:
        """A camera's raw file."""
        write_frame(self.folder / f"{name}.dng", frame)
        return self.folder / f"{name}.dng"


Writer = Callable[[Pair, Files], tuple[Path, Path]]
"""Writes measurement and PSF."""


@dataclass(frozen=True)
class Kind:
    """A way to spoil files; `colour` where all colours of the camera are used."""

    name: str
    write: Writer
    colour: bool = False
    scene: str = ""
    note: str = ""
    """What a line says that names the cause without a warning, as of good files of others."""


def psf_of(change: Callable[[Tensor], Tensor]) -> Writer:
    """The measurement as it is, with a PSF that is changed: linear values above black."""

    def write(pair: Pair, files: Files) -> tuple[Path, Path]:
        point = change(pair.point - BLACK) + BLACK
        return files.stated("raw", pair.raw), files.stated("psf", point)

    return write


def finer(by: int) -> Callable[[Tensor], Tensor]:
    return lambda psf: psf.repeat_interleave(by, -2).repeat_interleave(by, -1)


def noise_like(values: Tensor, deviation: float) -> Tensor:
    return deviation * torch.randn(values.shape, generator=torch.Generator().manual_seed(1))


def hot(psf: Tensor) -> Tensor:
    spoilt = psf.clone()
    spoilt[..., 40, 50] = WHITE - BLACK
    return spoilt


def blurred(psf: Tensor) -> Tensor:
    return nnf.avg_pool2d(nnf.avg_pool2d(psf[None], 5, 1, 2), 5, 1, 2)[0]


def encoded(values: Tensor) -> NDArray[np.uint8]:
    curve = srgb_from_linear((values - BLACK) / (WHITE - BLACK))
    return (255 * curve).round().byte().permute(1, 2, 0).numpy()


def jpeg(pair: Pair, files: Files) -> tuple[Path, Path]:
    path = files.folder / "raw.jpg"
    Image.fromarray(encoded(pair.raw)).save(path, quality=92)
    return path, files.raw("psf", pair.point_frame)


def gamma(pair: Pair, files: Files) -> tuple[Path, Path]:
    path = files.folder / "raw.png"
    Image.fromarray(encoded(pair.raw)).save(path)
    return path, files.plain("psf", pair.point - BLACK)


def not_numbers(pair: Pair, files: Files) -> tuple[Path, Path]:
    values = (pair.raw[0] - BLACK).numpy().copy()
    values[100:103, 80] = np.nan
    np.save(files.folder / "raw.npy", values)
    return files.folder / "raw.npy", files.stated("psf", pair.point)


def with_alpha(pair: Pair, files: Files) -> tuple[Path, Path]:
    opaque = torch.full_like(pair.raw[:1], 65535)
    picture = torch.cat([pair.raw - BLACK, opaque])
    raw = files.plain("raw", picture, extrasamples=["unassalpha"])
    return raw, files.plain("psf", pair.point - BLACK)


def eight_bits(pair: Pair, files: Files) -> tuple[Path, Path]:
    raw, psf = (
        files.plain(name, 250 * (each - BLACK) / (each - BLACK).max(), bits=8, compression="lzw")
        for name, each in (("raw", pair.raw), ("psf", pair.point))
    )
    return raw, psf


def same(pair: Pair, files: Files) -> tuple[Path, Path]:
    return files.stated("raw", pair.raw), files.stated("psf", pair.point)


class Cameras:
    """Cameras of the table, and what they take; each is made when it is needed."""

    @cached_property
    def mask(self) -> nl.Camera:
        """A contour mask behind the aperture of the camera ``live``."""
        made = nl.design_mask("contour", "live")
        return nl.Camera(made.loaded, pixels=PIXELS)

    @cached_property
    def pair(self) -> Pair:
        """A photograph in the middle of the view."""
        return Pair.of(self.mask)

    @cached_property
    def filled(self) -> Pair:
        """A scene wider than the sensor can see."""
        return Pair.of(self.mask, "75deg")

    @cached_property
    def bare(self) -> Pair:
        """The same mask without an aperture, so that its PSF goes on beyond the sensor."""
        camera = self.mask.loaded.camera
        mask = camera.mask.model_copy(update={"aperture": None})
        loaded = replace(self.mask.loaded, camera=camera.model_copy(update={"mask": mask}))
        return Pair.of(nl.Camera(loaded, pixels=PIXELS))

    @cached_property
    def other_point(self) -> Tensor:
        """The point source through the camera ``live`` with its own mask."""
        return Pair.of(nl.Camera("live", pixels=PIXELS)).point

    def point(self, distance: str) -> Tensor:
        """A point source at another distance than the scene."""
        frame = nl.simulate_point(self.mask, distance, wavelengths=1)
        return develop(frame).values

    def extended(self) -> Tensor:
        """The PSF beyond the sensor."""
        rows, columns = self.mask.size
        psf = nl.psf(self.mask, size=(rows + 80, columns + 100), wavelengths=1).values[1:2]
        return psf * (0.9 * (WHITE - BLACK) / psf.max())


def kinds(cameras: Cameras) -> list[Kind]:
    """All of them."""
    rows, columns = PIXELS[0] // 2, PIXELS[1] // 2
    return [
        Kind("files as they should be", same),
        Kind(
            "the same, of a colour camera (DNG)",
            lambda pair, files: (
                files.raw("raw", pair.shot.frame), files.raw("psf", pair.point_frame),
            ),
            colour=True,
        ),
        Kind(
            "files swapped",
            lambda pair, files: (files.stated("raw", pair.point), files.stated("psf", pair.raw)),
        ),
        Kind(
            "the same file twice",
            lambda pair, files: (files.stated("raw", pair.raw), files.stated("psf", pair.raw)),
        ),
        Kind("PSF of another camera", psf_of(lambda _: cameras.other_point[1:2] - BLACK)),
        Kind("point source 1 % nearer", psf_of(lambda _: cameras.point("297mm")[1:2])),
        Kind("point source 5 % nearer", psf_of(lambda _: cameras.point("285mm")[1:2])),
        Kind("point source at a quarter", psf_of(lambda _: cameras.point("75mm")[1:2])),
        Kind("PSF 1 % larger (refocused)", psf_of(lambda psf: magnified(psf, 1.01))),
        Kind("PSF 5 % larger", psf_of(lambda psf: magnified(psf, 1.05))),
        Kind("PSF mirrored left to right", psf_of(lambda psf: psf.flip(-1))),
        Kind("PSF upside down", psf_of(lambda psf: psf.flip(-2))),
        Kind("PSF rotated by 180°", psf_of(lambda psf: psf.flip(-2, -1))),
        Kind("PSF turned by 90°", psf_of(lambda psf: psf.transpose(-2, -1))),
        Kind("PSF 4 times finer", psf_of(finer(4))),
        Kind("PSF 2 times finer", psf_of(finer(2))),
        Kind("PSF 2 times coarser", psf_of(lambda psf: nnf.avg_pool2d(psf[None], 2)[0])),
        Kind("extended PSF", psf_of(lambda _: cameras.extended())),
        Kind("PSF padded with zeros", psf_of(lambda psf: nnf.pad(psf, (30, 30, 20, 20)))),
        Kind("PSF cropped", psf_of(lambda psf: psf[:, 24:-24, 30:-30])),
        Kind("square PSF", psf_of(lambda psf: psf[:, :, (columns - rows) // 2 :][:, :, :rows])),
        Kind(
            "black level unstated in the PSF",
            lambda pair, files: (files.stated("raw", pair.raw), files.plain("psf", pair.point)),
        ),
        Kind(
            "black level unstated in both",
            lambda pair, files: (files.plain("raw", pair.raw), files.plain("psf", pair.point)),
        ),
        Kind("saturated PSF", psf_of(lambda psf: (8 * psf).clamp(max=WHITE - BLACK))),
        Kind(
            "saturated measurement",
            lambda pair, files: (
                files.stated("raw", 3 * (pair.raw - BLACK) + BLACK),
                files.stated("psf", pair.point),
            ),
        ),
        Kind(
            "no point source: a flat frame as PSF",
            psf_of(lambda psf: 2000 + noise_like(psf, 20)),
        ),
        Kind("no point source: a dark frame as PSF", psf_of(lambda psf: noise_like(psf, 3))),
        Kind("faint PSF (1 % of the range)", psf_of(lambda psf: psf / 90 + noise_like(psf, 3))),
        Kind("PSF with a hot pixel", psf_of(hot)),
        Kind("PSF that is out of focus", psf_of(blurred)),
        Kind("PSF that reaches the edges", same, scene="bare"),
        Kind("TIFF of 8 bits with LZW", eight_bits),
        Kind(
            "grey PSF for a colour measurement",
            lambda pair, files: (
                files.raw("raw", pair.shot.frame), files.stated("psf", pair.point[1:2]),
            ),
            colour=True,
            note="a PSF in colour",
        ),
        Kind(
            "colour PSF for a grey measurement",
            lambda pair, files: (
                files.stated("raw", pair.raw), files.raw("psf", pair.point_frame),
            ),
        ),
        Kind("JPEG as measurement", jpeg, colour=True),
        Kind("PNG of a developed picture (sRGB) as measurement", gamma, colour=True),
        Kind("measurement with NaN", not_numbers),
        Kind("RGBA as measurement", with_alpha, colour=True),
        Kind(
            "measurement 20 columns narrower",
            lambda pair, files: (
                files.stated("raw", pair.raw[:, :, :-20]), files.stated("psf", pair.point),
            ),
        ),
        Kind("scene that fills the view", same, scene="filled"),
    ]  # fmt: skip


@dataclass(frozen=True)
class Outcome:
    """What came of a pair of files: the exit status, lines that were said, PSNR of a picture."""

    status: int
    lines: tuple[str, ...]
    psnr_db: float | None
    files: tuple[str, ...]

    @property
    def named(self) -> bool:
        """By an error without a file, or by a warning."""
        if self.status:
            return self.status == 2 and not self.files
        return any(line.startswith("warning: ") for line in self.lines)


def outcome(kind: Kind, pair: Pair) -> Outcome:
    """Run the command, and measure its picture."""
    with tempfile.TemporaryDirectory() as name:
        files = Files(Path(name))
        raw, psf = kind.write(pair, files)
        before = set(files.folder.iterdir())
        picture = files.folder / "picture.tif"
        command = [NOLENS, "reconstruct", raw, "--psf", psf, "-o", picture]
        ran = subprocess.run(list(map(str, command)), capture_output=True, text=True, check=False)
        written = tuple(sorted(each.name for each in set(files.folder.iterdir()) - before))
        said = ran.stderr.replace(f"{name}/", "").splitlines()
        lines = tuple(line.removeprefix("nolens: ") for line in said)
        psnr = psnr_of(picture, pair) if ran.returncode == 0 else None
        return Outcome(ran.returncode, lines, psnr, written)


def psnr_of(path: Path, pair: Pair) -> float | None:
    """PSNR of the scene's part of a picture; None of one on other pixels."""
    record = json.loads(path.with_suffix(".json").read_text())["parameters"]
    top, left, height, width = record["window"]
    rows, columns = record["sensor"]
    stored = tifffile.imread(path).astype(np.float32)
    values = torch.from_numpy(np.atleast_3d(stored)).permute(2, 0, 1)
    frame = torch.zeros(len(values), 3 * rows, 3 * columns)
    frame[:, rows + top :, columns + left :][:, :height, :width] = values
    inside = pair.support
    part = frame[:, rows + inside.top :, columns + inside.left :]
    part = part[:, : inside.height, : inside.width]
    if part.shape != pair.truth.shape:
        return None
    # A grey PSF tells nothing of how the colours are balanced.
    factors = (part * pair.truth).sum((-2, -1)) / part.square().sum((-2, -1))
    return nl.psnr(part * factors[:, None, None], pair.truth)


def cell(text: str) -> str:
    return text.replace("|", "\\|")


def table(rows: list[tuple[Kind, Outcome, float]], alarms: Path) -> str:
    """The page."""
    lines = [
        "# Wrong and odd files",
        "",
        "Made by `make bench-odd`: a photograph 20° wide and a point source, taken by a simulated",
        f"camera of {PIXELS[0]}×{PIXELS[1]} pixels with a contour mask behind an aperture; the two",
        "files, spoilt in one way after the other, are given to `nolens reconstruct` without any",
        "option. A picture is right where its PSNR, after a factor for each colour, is within",
        f"{RIGHT_DB} dB of that of the unspoilt files; the column is what it lacks. The scene that",
        "fills the view and the camera without an aperture are compared with the same picture.",
        "",
        "| files | what happens | loss, dB | what is said |",
        "|---|---|---|---|",
    ]
    for kind, came, loss in rows:
        shown = amount(round(loss, 1)) if came.psnr_db is not None else ""
        said = "; ".join(came.lines)
        lines.append(f"| {kind.name} | {verdict(kind, came, loss)} | {shown} | {cell(said)} |")
    said_of = alarms.read_text().splitlines()
    lines += [
        "",
        "## False alarms",
        "",
        "By `python bench/alarms.py --data ../shared/data`: photographs through five cameras at",
        "three exposures, the five pairs and the hand, each with its own PSF; and some with one",
        "thing wrong. The counts, and what is said of each problem that has a word:",
        "",
        *(f"- {line}" for line in said_of[-2:]),
        *(f"- {line}" for line in said_of[:-2] if not line.endswith(": nothing")),
    ]
    return "\n".join([*lines, ""])


def verdict(kind: Kind, came: Outcome, loss: float) -> str:
    """In a word or two."""
    if came.status:
        return "refused" if came.named else f"exit status {came.status}"
    right = came.psnr_db is not None and loss <= RIGHT_DB
    if right:
        return "right, with a warning" if came.named else "right"
    if came.named:
        return "warned"
    noted = kind.note and any(kind.note in line for line in came.lines)
    return "noted" if noted else "SILENT"


def main() -> None:
    """Run all, and write the page."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, default=Path("docs/odd-inputs.md"))
    parser.add_argument("--alarms", type=Path, default=Path("build/alarms.txt"))
    parser.add_argument("--kinds", nargs="+", help="names or parts of them")
    asked = parser.parse_args()
    torch.manual_seed(0)
    cameras = Cameras()
    rows: list[tuple[Kind, Outcome, float]] = []
    base: dict[bool, float] = {}
    for kind in kinds(cameras):
        if asked.kinds and not any(each in kind.name for each in asked.kinds):
            continue
        pair = getattr(cameras, kind.scene or "pair")
        came = outcome(kind, pair if kind.colour else pair.green)
        if came.psnr_db is not None and kind.colour not in base:
            base[kind.colour] = came.psnr_db
        loss = 0.0 if came.psnr_db is None else base[kind.colour] - came.psnr_db
        rows.append((kind, came, loss))
        print(f"{kind.name}: {verdict(kind, came, loss)}, {loss:.2f} dB: {' | '.join(came.lines)}",
              flush=True)  # fmt: skip
    if not asked.kinds:
        asked.out.write_text(table(rows, asked.alarms))


if __name__ == "__main__":
    main()
