"""Every script in `examples/` runs, and makes its pictures."""

import runpy
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

EXAMPLES = sorted((Path(__file__).parents[2] / "examples").glob("*.py"))


@pytest.mark.parametrize("script", EXAMPLES, ids=lambda each: each.stem)
def test_example(
    script: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.chdir(tmp_path)
    runpy.run_path(str(script), run_name="__main__")
    assert capsys.readouterr().err == ""
    pictures = sorted(tmp_path.glob(f"{script.stem}*.png"))
    assert pictures
    for each in pictures:
        with Image.open(each) as picture:
            assert np.asarray(picture).std() > 5, each
    page = (script.parents[1] / "docs" / "examples.md").read_text()
    assert f"examples/{script.name}" in page
    assert all(f"examples/{each.name}" in page for each in pictures)
