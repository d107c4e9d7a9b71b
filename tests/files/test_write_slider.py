"""The page with a slider, in a real browser."""

import base64
import html
import io
import json
import math
import re
import shutil
import subprocess
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from PIL import Image

from nolens.files.stacks import write_slider

CHROMIUM = shutil.which("chromium") or shutil.which("google-chrome")
DEPTHS = (50e3, 80e3, 200e3, math.inf)
PLACES = (0.0, 0.4, 0.75, 1.0)
SIZE = (120, 200)

in_browser = pytest.mark.skipif(CHROMIUM is None, reason="no chromium here to open the page with")


def page(title: str = "raw.dng refocused") -> dict[str, Any]:
    """Pages of one grey each, and the far half of the picture at the right."""
    greys = torch.tensor([0.2, 0.4, 0.6, 0.8])[:, None, None, None]
    best_page = torch.zeros(SIZE, dtype=torch.long)
    best_page[:, 100:] = 3
    best_page[100:, 100:] = 2
    return {
        "title": title,
        "pages": greys.expand(4, 1, *SIZE),
        "depths_um": DEPTHS,
        "places": PLACES,
        "everywhere": torch.full((1, *SIZE), 0.5),
        "best_page": best_page,
        "white": 1.0,
    }


def opened(path: Path, script: str) -> dict[str, Any]:
    """What a script that runs in the page finds: it puts JSON into `found`."""
    assert CHROMIUM is not None
    text = path.read_text(encoding="utf-8")
    told = "<script>addEventListener('load', () => { let found = {};" + script
    told += "; document.body.dataset.found = JSON.stringify(found); });</script></body>"
    asked = path.with_name("asked.html")
    asked.write_text(text.replace("</body>", told), encoding="utf-8")
    done = subprocess.run(
        [CHROMIUM, "--headless", "--no-sandbox", "--disable-gpu", "--window-size=900,800",
         f"--user-data-dir={path.parent / 'profile'}", "--virtual-time-budget=3000", "--dump-dom",
         asked.as_uri()],
        capture_output=True, text=True, timeout=60, check=True,
    )  # fmt: skip
    match = re.search(r'data-found="([^"]*)"', done.stdout)
    assert match is not None, done.stdout[-500:]
    found: dict[str, Any] = json.loads(html.unescape(match[1]))
    return found


_HELPERS = """
const $ = (id) => document.getElementById(id);
const number = () => stack.pages.indexOf($('picture').src);
const at = (x, y) => {
  const box = $('picture').getBoundingClientRect();
  $('picture').dispatchEvent(new MouseEvent('click', {clientX: box.left + x * box.width,
    clientY: box.top + y * box.height, bubbles: true}));
  return [number(), $('shown').textContent, $('mark').hidden];
};
"""


@in_browser
def test_slider_keyboard_and_clicks(tmp_path: Path) -> None:
    write_slider(tmp_path / "sweep.html", **page())
    found = opened(tmp_path / "sweep.html", _HELPERS + """
      found.start = [$('shown').textContent, $('picture').src === stack.everywhere,
        $('picture').naturalWidth, $('picture').naturalHeight];
      $('depth').value = 2;
      $('depth').dispatchEvent(new Event('input'));
      found.moved = [number(), $('shown').textContent, $('picture').alt,
        $('depth').getAttribute('aria-valuetext'), $('all').getAttribute('aria-pressed')];
      found.left = at(0.2, 0.5);
      found.right = at(0.8, 0.2);
      found.above = at(0.8, 0.75);
      found.corner = at(0.8, 0.95);
      found.edge = at(1.0, 1.0);
      $('all').click();
      found.all = [$('shown').textContent, $('mark').hidden, $('picture').src === stack.everywhere];
      found.labelled = document.querySelector('label').control === $('depth');
      $('depth').focus();
      found.focus = document.activeElement === $('depth');
      const box = $('picture').getBoundingClientRect();
      found.ratio = box.width / box.height;
      found.fits = document.documentElement.scrollWidth <= innerWidth;
    """)  # fmt: skip
    assert found["start"] == ["everywhere", True, 200, 120]
    assert found["moved"] == [2, "20 cm", "The scene, sharp at 20 cm", "20 cm", "false"]
    assert found["left"] == [0, "5 cm", False]
    assert found["right"] == found["above"] == [3, "infinity", False]
    assert found["corner"] == found["edge"] == [2, "20 cm", False]
    assert found["all"] == ["everywhere", True, True]
    assert found["labelled"] and found["focus"] and found["fits"]
    assert found["ratio"] == pytest.approx(200 / 120, rel=0.01)


@in_browser
def test_sweep_goes_there_and_back(tmp_path: Path) -> None:
    write_slider(tmp_path / "sweep.html", **page())
    found = opened(tmp_path / "sweep.html", _HELPERS + """
      let tick = null;
      window.setInterval = (step) => { tick = step; return 7; };
      $('play').click();
      found.pressed = $('play').getAttribute('aria-pressed');
      found.seen = [];
      for (let n = 0; n < 7; n++) { tick(); found.seen.push(number()); }
      $('play').click();
      found.after = $('play').getAttribute('aria-pressed');
    """)  # fmt: skip
    assert found["pressed"] == "true" and found["after"] == "false"
    assert found["seen"] == [1, 2, 3, 2, 1, 0, 1]


def test_needs_no_other_file(tmp_path: Path) -> None:
    write_slider(tmp_path / "sweep.html", **page("</script><b>&"))
    text = (tmp_path / "sweep.html").read_text(encoding="utf-8")
    assert "default-src 'none'" in text
    assert not re.search(r"(?:src|href)\s*=\s*[\"'](?!data:)", text)
    assert "http://" not in text and "https://" not in text and "url(" not in text
    assert "&lt;/script&gt;&lt;b&gt;&amp;" in text and "</script><b>" not in text
    pictures = re.findall(r"data:image/png;base64,([A-Za-z0-9+/=]+)", text)
    assert len(pictures) == 6  # Four depths, and the one that is sharp everywhere twice.
    with Image.open(io.BytesIO(base64.b64decode(pictures[1]))) as picture:
        assert picture.size == SIZE[::-1]
        # sRGB of 0.2 is 124.
        assert np.asarray(picture).max() == np.asarray(picture).min() == 124
    write_slider(tmp_path / "again.html", **page("</script><b>&"))
    assert (tmp_path / "again.html").read_bytes() == (tmp_path / "sweep.html").read_bytes()
