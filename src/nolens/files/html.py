"""Pages for a browser that need no other file: what all have, and a focal stack with a slider."""

import json
from base64 import b64encode
from collections.abc import Sequence
from html import escape
from importlib.resources import files
from pathlib import Path

from torch import Tensor

from nolens.files.atomic import atomic_write
from nolens.files.stacks import depth_text, page_png

_GRID = 64
_POLICY = """<meta http-equiv="Content-Security-Policy"
 content="default-src 'none'; img-src data:; style-src 'unsafe-inline'; script-src 'unsafe-inline'">
"""


def html_page(
    title: str, body: str, *, style: str, scheme: str, head: str = "", end: str = ""
) -> str:
    """Put a document together.

    Parameters
    ----------
    title
        As plain text.
    body
        Markup of what it shows.
    style
        File of its style, beside this one.
    scheme
        Colour schemes that the style knows: light, dark or both.
    head
        More markup of the head.
    end
        Markup after what it shows.
    """
    css = (files("nolens.files") / style).read_text(encoding="utf-8")
    return f"""<!DOCTYPE html>
<html lang="en-GB">
<head>
<meta charset="utf-8">
<meta name="viewport" content="width=device-width, initial-scale=1">
<meta name="color-scheme" content="{scheme}">
{head}<title>{escape(title)}</title>
<style>
{css}</style>
</head>
<body>
<main>
{body}</main>
{end}</body>
</html>
"""


def write_slider(
    path: str | Path,
    *,
    title: str,
    pages: Tensor,
    depths_um: Sequence[float],
    places: Sequence[float],
    everywhere: Tensor,
    sharpest: Tensor,
    white: float,
) -> None:
    """Write a focal stack as a page that needs no other file and no network.

    A slider, the keyboard and a click on what is to be sharp choose the depth. The same stack gives
    the same bytes.

    Parameters
    ----------
    path
        The file to write.
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
        "sharpest": sharpest[step // 2 :: step, step // 2 :: step].tolist(),
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
    html = html_page(
        title,
        body,
        style="slider.css",
        scheme="dark",
        head=_POLICY,
        end=f"<script>\nconst stack = {data};\n{script}</script>\n",
    )
    with atomic_write(path) as temporary:
        temporary.write_text(html, encoding="utf-8", newline="\n")


def _embedded(page: Tensor, white: float) -> str:
    return "data:image/png;base64," + b64encode(page_png(page, white)).decode("ascii")
