"""Drafts beside photographs, over the simulated cameras and scenes of `bench/default.py`.

`make bench-draft` (`python bench/draft.py`) reconstructs each measurement by `--quality draft` and
by default, without any option but its files, and writes a part of `docs/default.md`: PSNR in dB,
and processor seconds. What was measured is kept in `--folder`, so that it can be interrupted and
continued.
"""

from __future__ import annotations

import argparse
import json
import statistics
import time
from pathlib import Path

import torch
from skimage import data

import nolens as nl
from default import CAMERAS, EXPOSURES, PHOTOGRAPHS, Case, cases, lines_from, overlap, wider
from machine import describe
from page import write_part

WAYS = ("draft", "photo")

Row = dict[str, dict[str, float]]


def measure(case: Case, camera: nl.Camera) -> Row:
    """PSNR and seconds by way."""
    angle = CAMERAS[case.camera][0]
    scene = getattr(data, case.photograph)()
    shot = nl.simulate(scene, camera, angle=angle, fill=case.exposure, field_points=3)
    psf = nl.psf(camera, "300mm", support=wider(shot.support), wavelengths=1)
    rows, columns = overlap(shot)
    there = shot.expected[
        :, lines_from(rows, shot.support.top), lines_from(columns, shot.support.left)
    ]
    row: Row = {}
    for way in WAYS:
        begun = time.process_time()
        picture = nl.reconstruct(shot.frame, psf, quality=way)
        seconds = time.process_time() - begun
        row[way] = {"psnr_db": nl.psnr(picture.values[:, rows, columns], there), "cpu_s": seconds}
    return row


def page(rows: dict[Case, Row]) -> str:
    """Markdown of all."""
    lines = [
        f"Made by `make bench-draft` on {describe()['cpu']}, one thread: the measurements of the",
        f"table above, {len(rows)} of {len(CAMERAS) * len(PHOTOGRAPHS) * len(EXPOSURES)}, by "
        "`--quality draft` and by default, each with its files",
        "alone. PSNR in dB, mean and range over photographs and exposures; median of",
        "processor seconds of draft and photo.",
        "",
        "| camera | draft | photo | seconds |",
        "|---|---|---|---|",
    ]
    for camera in CAMERAS:
        own = [row for case, row in rows.items() if case.camera == camera]
        if not own:
            continue
        cells = [camera]
        for way in WAYS:
            reached = [row[way]["psnr_db"] for row in own]
            least, most = min(reached), max(reached)
            cells.append(f"{statistics.mean(reached):.2f} ({least:.1f} to {most:.1f})")
        seconds = [statistics.median(row[way]["cpu_s"] for row in own) for way in WAYS]
        cells.append(", ".join(f"{each:.1f}" for each in seconds))
        lines.append("| " + " | ".join(cells) + " |")
    return "\n".join(lines)


def main() -> None:
    """Measure what is missing, and write the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--folder", type=Path, default=Path("build/draft"))
    parser.add_argument("--out", type=Path, default=Path("docs/default.md"))
    asked = parser.parse_args()
    asked.folder.mkdir(parents=True, exist_ok=True)
    torch.set_num_threads(1)
    torch.manual_seed(0)
    cameras: dict[str, nl.Camera] = {}
    rows: dict[Case, Row] = {}
    for case in cases():
        path = asked.folder / case.file
        if not path.exists():
            if case.camera not in cameras:
                cameras = {case.camera: CAMERAS[case.camera][1]()}
            path.write_text(json.dumps(measure(case, cameras[case.camera])))
        rows[case] = json.loads(path.read_text())
        print(case.file, rows[case], flush=True)
        write_part(asked.out, "bench/draft.py", page(rows))


if __name__ == "__main__":
    main()
