"""Focal stacks and depth maps: TIFF, an animated PNG, a page with a slider, a map in colours."""

import json
import math
from base64 import b64encode
from collections.abc import Callable, Sequence
from functools import partial
from html import escape
from importlib.resources import files
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np
import tifffile
from PIL import Image, ImageDraw, ImageFont
from torch import Tensor

from nolens.camera import exposure_white
from nolens.files.atomic import atomic_write
from nolens.files.ome import write_ome_tiff
from nolens.files.pictures import screen_picture, write_png
from nolens.files.plots import plot_figure
from nolens.files.reports import html_page
from nolens.files.tiff import write_tiff
from nolens.refocusing import AllInFocus, FocalStack

_MM = "mm"
_STRIP = 26
_NARROWEST = 150
_INK, _PALE, _PAPER = (235, 235, 235), (110, 110, 110), (20, 20, 20)
_LABEL = 76
_PAUSE_MS, _STEP_MS = 700, 220

_GRID = 64
_POLICY = """<meta http-equiv="Content-Security-Policy"
 content="default-src 'none'; img-src data:; style-src 'unsafe-inline'; script-src 'unsafe-inline'">
"""

_WIDE_INCHES = 7.5
_UNKNOWN = 0.25
_MOST_TICKS = 12


STACK_FILES = {
    "stack": "stack.tif",
    "sweep": "sweep.png",
    "page with a slider": "sweep.html",
    "picture that is sharp everywhere": "all-in-focus.png",
    "depth map": "depth.png",
    "depths": "depth.tif",
}
"""Files of a focal stack, by what they hold."""


def stack_writers(
    folder: Path, stack: FocalStack, together: AllInFocus, title: str
) -> dict[Path, Callable[[Path], None]]:
    """What writes each file of a stack; all pictures have the white of the one sharp everywhere."""
    white = exposure_white(together.picture)
    depths = stack.depths_um
    pages: dict[str, Any] = {"pages": stack.pages, "depths_um": depths, "white": white}
    writers: dict[str, Callable[[Path], None]] = {
        "stack": partial(write_stack, **pages),
        "sweep": partial(write_sweep, **pages, places=stack.places),
        "page with a slider": partial(
            write_slider,
            **pages,
            title=title,
            places=stack.places,
            everywhere=together.picture,
            best_page=stack.nearest_pages(together.per_m),
        ),
        "picture that is sharp everywhere": partial(write_png, radiance=together.picture),
        "depth map": partial(
            plot_depth, per_m=together.per_m, confidence=together.confidence, depths_um=depths
        ),
        "depths": partial(write_depths, per_m=together.per_m),
    }
    return {folder / STACK_FILES[what]: write for what, write in writers.items()}


VOLUME_FILES = {
    "volume": "volume.ome.tif",
    "page that turns": "volume.html",
    **{what: name for what, name in STACK_FILES.items() if what != "stack"},
}
"""Files of planes that were solved together, by what they hold."""


def volume_writers(
    folder: Path,
    stack: FocalStack,
    together: AllInFocus,
    title: str,
    channels: Sequence[str],
) -> dict[Path, Callable[[Path], None]]:
    """What writes each file of planes that were solved together: see `stack_writers`."""
    of_stack = stack_writers(folder, stack, together, title)
    del of_stack[folder / STACK_FILES["stack"]]
    numbers = [each * 1e-3 for each in stack.depths_um for _ in channels]
    pixels: dict[str, Any] = {
        "Description": "depths_mm=" + ",".join(_number(each) for each in stack.depths_um)
    }
    if all(map(math.isfinite, numbers)):  # Readers of OME know no infinite number.
        pixels["Plane"] = {"PositionZ": numbers, "PositionZUnit": [_MM] * len(numbers)}
    return {
        folder / VOLUME_FILES["volume"]: partial(
            write_ome_tiff, stack=stack.pages, axis="Z", channels=channels, pixels=pixels
        ),
        folder / VOLUME_FILES["page that turns"]: partial(
            write_turning, title=title, stack=stack, white=exposure_white(together.picture)
        ),
        **of_stack,
    }


def depth_text(depth_um: float) -> str:
    """A depth as people say it, with three digits."""
    if math.isinf(depth_um):
        return "infinity"
    for unit, size in (("m", 1e6), ("cm", 1e4)):
        if depth_um >= size:
            return f"{depth_um / size:.3g} {unit}"
    return f"{depth_um / 1e3:.3g} {_MM}"


def write_stack(
    path: str | Path, pages: Tensor, depths_um: Sequence[float], *, white: float
) -> None:
    """Write a focal stack as one 16-bit TIFF of many pages, linear, as ImageJ reads it.

    Every page, or every channel of one, is a slice with its depth as its label; `depths_mm` in
    the file's description has them all.

    Parameters
    ----------
    pages
        Radiance, (depths, 1 or 3, rows, columns).
    depths_um
        Of the pages.
    white
        Radiance that 65535 stands for, in all of them; what is brighter clips.

    Raises
    ------
    FileError
        If the file cannot be written.
    """
    counts = ((pages.double() / white).clamp(0, 1) * 65535).round().numpy().astype(np.uint16)
    colour = counts.shape[1] == 3
    names = ("R", "G", "B") if colour else ("",)
    labels = [f"{depth_text(each)} {name}".strip() for each in depths_um for name in names]
    more = {"mode": "composite"} if colour else {}
    with atomic_write(path) as temporary:
        tifffile.imwrite(
            temporary,
            counts if colour else counts[:, 0],
            imagej=True,
            photometric="minisblack",
            metadata={
                "axes": "ZCYX" if colour else "ZYX",
                "Labels": labels,
                **more,
                "depths_mm": ",".join(_number(each) for each in depths_um),
                "linear": "true",
                "per_count": f"{white / 65535:.9g}",
            },
        )


def write_depths(path: str | Path, per_m: Tensor) -> None:
    """Write a depth map, 1/z in 1/m (rows, columns), as 32-bit float TIFF in mm.

    Infinity stays infinite.

    Raises
    ------
    FileError
        If the file cannot be written.
    """
    millimetres = (1e3 / per_m.clamp_min(0)).numpy().astype(np.float32)
    write_tiff(path, millimetres, {"quantity": "depth", "unit": _MM})


def _number(depth_um: float) -> str:
    return "infinity" if math.isinf(depth_um) else f"{depth_um * 1e-3:.6g}"


def write_sweep(
    path: str | Path,
    pages: Tensor,
    depths_um: Sequence[float],
    places: Sequence[float],
    *,
    white: float,
) -> None:
    """Write pictures at many depths as one animated PNG, there and back, without an end.

    Parameters
    ----------
    pages
        Radiance, (depths, 1 or 3, rows, columns).
    depths_um
        Of the pages; each is written under its picture.
    places
        Where the depths lie between the first (0) and the last (1), in 1/z.
    white
        Radiance that is white in all of them.

    Raises
    ------
    FileError
        If the file cannot be written.
    """
    frames = [
        _labelled(screen_picture(page, white), depth_text(depth), place)
        for page, depth, place in zip(pages, depths_um, places, strict=True)
    ]
    pauses = [_STEP_MS] * len(frames)
    pauses[0] = pauses[-1] = _PAUSE_MS
    back = slice(-2, 0, -1)
    with atomic_write(path) as temporary:
        frames[0].save(
            temporary,
            format="png",
            save_all=True,
            append_images=[*frames[1:], *frames[back]],
            duration=[*pauses, *pauses[back]],
            loop=0,
        )


def _labelled(picture: Image.Image, text: str, place: float) -> Image.Image:
    """The picture above its depth, and where that lies among all of them."""
    width = max(picture.width, _NARROWEST)
    frame = Image.new("RGB", (width, picture.height + _STRIP), _PAPER)
    frame.paste(picture, ((width - picture.width) // 2, 0))
    draw = ImageDraw.Draw(frame)
    middle = picture.height + _STRIP // 2
    draw.text((8, middle), text, fill=_INK, font=ImageFont.load_default(13), anchor="lm")
    left, right = _LABEL, width - 12
    draw.line((left, middle, right, middle), fill=_PALE, width=2)
    at = left + place * (right - left)
    draw.ellipse((at - 4, middle - 4, at + 4, middle + 4), fill=_INK)
    return frame


def write_slider(
    path: str | Path,
    *,
    title: str,
    pages: Tensor,
    depths_um: Sequence[float],
    places: Sequence[float],
    everywhere: Tensor,
    best_page: Tensor,
    white: float,
) -> None:
    """Write a focal stack as a page that needs no other file and no network.

    A slider, the keyboard and a click on what is to be sharp choose the depth. The same stack gives
    the same bytes.

    Parameters
    ----------
    title
        Over all.
    pages
        Radiance, (depths, 1 or 3, rows, columns).
    depths_um
        Of the pages, the nearest first.
    places
        Where the depths lie between the first (0) and the last (1), in 1/z.
    everywhere
        The picture that is sharp everywhere, (1 or 3, rows, columns).
    best_page
        Number of the sharpest page for every pixel, (rows, columns).
    white
        Radiance that is white in all pictures.

    Raises
    ------
    FileError
        If the file cannot be written.
    """
    script = (files("nolens.files") / "slider.js").read_text(encoding="utf-8")
    texts = [depth_text(each) for each in depths_um]
    rows, columns = everywhere.shape[-2:]
    step = max(1, -(-max(rows, columns) // _GRID))
    stack = {
        "depths": texts,
        "pages": [_embedded(each, white) for each in pages],
        "everywhere": _embedded(everywhere, white),
        "best_page": best_page[step // 2 :: step, step // 2 :: step].tolist(),
    }
    # A script ends at the first "</", wherever it stands.
    data = json.dumps(stack, ensure_ascii=True).replace("</", "<\\/")
    ticks = "\n".join(
        f'<span style="left:{100 * place:.2f}%" title="{escape(text)}"></span>'
        for place, text in zip(places, texts, strict=True)
    )
    body = f"""<h1>{escape(title)}</h1>
<div class="frame" style="max-width:calc(72vh * {columns} / {rows})">
<img id="picture" src="{stack["everywhere"]}" width="{columns}" height="{rows}"
 alt="The scene, sharp everywhere">
<span id="mark" hidden></span>
</div>
<div class="controls">
<label for="depth">Depth</label>
<output id="shown" for="depth" aria-live="polite">everywhere</output>
<div class="slide">
<input id="depth" type="range" min="0" max="{len(texts) - 1}" step="1" value="0"
 aria-describedby="help">
<div class="ticks" aria-hidden="true">
{ticks}
</div>
<div class="ends" aria-hidden="true">
<span>{escape(texts[0])}</span><span>{escape(texts[-1])}</span></div>
</div>
<button id="play" type="button" aria-pressed="false">Sweep</button>
<button id="all" type="button" aria-pressed="true">Sharp everywhere</button>
</div>
<p id="help">Drag the slider or use the arrow keys. Click on what is to be sharp.</p>
<noscript><p>This page needs JavaScript to change the depth; the picture is sharp everywhere.</p>
</noscript>
"""
    _write_page(path, title, body, f"const stack = {data};\n{script}")


def write_turning(path: str | Path, *, title: str, stack: FocalStack, white: float) -> None:
    """Write planes as a page that turns them: dragged to a side, near ones move past far ones.

    The planes' light adds up. The page needs no other file and no network.

    Parameters
    ----------
    title
        Over all.
    stack
        The planes.
    white
        Radiance that is white.

    Raises
    ------
    FileError
        If the file cannot be written.
    """
    script = (files("nolens.files") / "turning.js").read_text(encoding="utf-8")
    rows, columns = stack.pages.shape[-2:]
    planes = "\n".join(
        f'<img class="plane" data-place="{place:.4f}" src="{_embedded(page, white)}" '
        f'alt="{escape(depth_text(depth))}">'
        for page, depth, place in zip(stack.pages, stack.depths_um, stack.places, strict=True)
    )
    depths = ", ".join(depth_text(each) for each in stack.depths_um)
    body = f"""<h1>{escape(title)}</h1>
<div class="frame" id="volume" tabindex="0" role="group" aria-label="The planes, one behind another"
 style="max-width:calc(72vh * {columns} / {rows});aspect-ratio:{columns}/{rows}">
{planes}
</div>
<p id="help">Planes at {depths}. Drag, or use the arrow keys, to look from another side; a double
click looks straight ahead. Planes stand where 1/distance has them.</p>
"""
    _write_page(path, title, body, script)


def _write_page(path: str | Path, title: str, body: str, script: str) -> None:
    html = html_page(
        title,
        body,
        style="slider.css",
        scheme="dark",
        head=_POLICY,
        end=f"<script>\n{script}</script>\n",
    )
    with atomic_write(path) as temporary:
        temporary.write_text(html, encoding="utf-8", newline="\n")


def _embedded(page: Tensor, white: float) -> str:
    """Radiance (1 or 3, rows, columns) as a PNG in the page."""
    buffer = BytesIO()
    screen_picture(page, white).save(buffer, "png", optimize=True)
    return "data:image/png;base64," + b64encode(buffer.getvalue()).decode("ascii")


def plot_depth(path: Path, per_m: Tensor, confidence: Tensor, depths_um: Sequence[float]) -> None:
    """Draw a depth map in colours, and grey where nothing tells the depth.

    Parameters
    ----------
    per_m
        1/z of every pixel in 1/m, (rows, columns).
    confidence
        From 0 to 1, as `nolens.refocusing.AllInFocus` has it.
    depths_um
        Depths of the stack that it comes from, the nearest first.
    """
    # It takes a third of a second, which other commands need not wait.
    import matplotlib as mpl
    from matplotlib.cm import ScalarMappable
    from matplotlib.colors import Normalize

    known = [1e6 / each for each in depths_um]
    norm, colour_map = Normalize(min(known), max(known) + 1e-9), mpl.colormaps["viridis"]
    colours = colour_map(norm(per_m.numpy()))[..., :3]
    sure = (confidence / _UNKNOWN).clamp(0, 1).numpy()[..., None]
    colours = colours * sure + 0.75 * (1 - sure)
    rows, columns = per_m.shape
    size = (_WIDE_INCHES, np.clip(_WIDE_INCHES * 0.8 * rows / columns + 0.5, 2, 12))
    with plot_figure(path, size) as figure:
        axes = figure.add_subplot()
        axes.imshow(colours, interpolation="nearest")
        axes.set_xlabel("column, pixels")
        axes.set_ylabel("row, pixels")
        bar = figure.colorbar(ScalarMappable(norm, colour_map), ax=axes)
        every = -(-len(known) // _MOST_TICKS)
        bar.set_ticks(known[::every], labels=[depth_text(each) for each in depths_um[::every]])
        bar.set_label("distance (grey: not known)")
