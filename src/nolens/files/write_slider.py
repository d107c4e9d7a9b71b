"""Writing a focal stack as a web page with a slider for the depth."""

import json
from base64 import b64encode
from collections.abc import Sequence
from dataclasses import dataclass
from html import escape
from importlib.resources import files
from pathlib import Path

from torch import Tensor

from nolens.files.atomic import atomic_write
from nolens.files.html_page import html_page
from nolens.files.write_stack import depth_text
from nolens.files.write_sweep import page_png

_GRID = 64
_POLICY = """<meta http-equiv="Content-Security-Policy"
 content="default-src 'none'; img-src data:; style-src 'unsafe-inline'; script-src 'unsafe-inline'">
"""


@dataclass(frozen=True)
class SliderPage:
    """What the page shows.

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
    sharpest
        Number of the sharpest page for every pixel, (rows, columns).
    white
        Radiance that is white in all pictures.
    """

    title: str
    pages: Tensor
    depths_um: Sequence[float]
    places: Sequence[float]
    everywhere: Tensor
    sharpest: Tensor
    white: float


def write_slider(path: str | Path, page: SliderPage) -> None:
    """Write a page that needs no other file and no network.

    A slider, the keyboard and a click on what is to be sharp choose the depth. The same page gives
    the same bytes.

    Parameters
    ----------
    path
        The file to write.
    page
        What is on it.

    Raises
    ------
    FileError
        If the file cannot be written.
    """
    with atomic_write(path) as temporary:
        temporary.write_text(_html(page), encoding="utf-8", newline="\n")


def _html(page: SliderPage) -> str:
    script = (files("nolens.files") / "write_slider.js").read_text(encoding="utf-8")
    count = len(page.depths_um)
    texts = [depth_text(each) for each in page.depths_um]
    rows, columns = page.everywhere.shape[-2:]
    step = max(1, -(-max(rows, columns) // _GRID))
    told = {
        "depths": texts,
        "pages": [_embedded(each, page.white) for each in page.pages],
        "everywhere": _embedded(page.everywhere, page.white),
        "sharpest": page.sharpest[step // 2 :: step, step // 2 :: step].tolist(),
    }
    # A script ends at the first "</", wherever it stands.
    data = json.dumps(told, ensure_ascii=True).replace("</", "<\\/")
    ticks = "\n".join(
        f'<span style="left:{100 * place:.2f}%" title="{escape(text)}"></span>'
        for place, text in zip(page.places, texts, strict=True)
    )
    body = f"""<h1>{escape(page.title)}</h1>
<div class="frame" style="max-width:calc(72vh * {columns} / {rows})">
<img id="picture" src="{told["everywhere"]}" width="{columns}" height="{rows}"
 alt="The scene, sharp everywhere">
<span id="mark" hidden></span>
</div>
<div class="controls">
<label for="depth">Depth</label>
<output id="shown" for="depth" aria-live="polite">everywhere</output>
<div class="slide">
<input id="depth" type="range" min="0" max="{count - 1}" step="1" value="0"
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
    return html_page(
        page.title,
        body,
        style="write_slider.css",
        scheme="dark",
        head=_POLICY,
        end=f"<script>\nconst told = {data};\n{script}</script>\n",
    )


def _embedded(page: Tensor, white: float) -> str:
    return "data:image/png;base64," + b64encode(page_png(page, white)).decode("ascii")
