"""Fig. 7 beside the paper's: photographs of a screen and of other scenes."""

from collections.abc import Mapping
from functools import partial

from torch import Tensor

from nolens.camera import exposure_white
from nolens.files.plot_reproduce_pictures import Panel, plot_pictures
from nolens.reproduction.photographs import SCENES, SOLVED_AS_PAPER, Scene
from nolens.reproduction.rows import Row, not_made
from nolens.reproduction.steps import Found
from nolens.reproduction.tell.draft import Draft, Drawn
from nolens.reproduction.workbench import Workbench

_TITLE = "Fig. 7: photographs"
_PAPERS_MS = (40.0, 70.0)
_SCREEN_CD_M2 = 200.0
"""White of a usual screen, as `nolens simulate` assumes."""
_STRETCH, _GREY = 10.0, 0.3
_LIGHT = {"7a": "a screen", "7b": "a screen", "7c": "a screen"}


def photographs(work: Workbench, found: Mapping[str, Found]) -> Draft:
    """All scenes, each with what the paper's way makes of it where that was tried."""
    texts = (
        "The paper's pictures are not to be had: photographs that come with scikit-image stand "
        "for them, flat, at the paper's distances. Of the real scenes of fig. 7d–f the paper "
        "gives the distance alone; they fill 40° here. Each is measured with PSFs that change "
        f"over the field ({work.size.field_points}×{work.size.field_points} of them), noise and "
        "mosaic, exposed to 90 % of a full pixel, and solved with the PSF of its distance by "
        f"{work.size.iterations} iterations of ADMM (eq. 7, τ = 10⁻⁵).",
        "Two things differ from the paper's way of solving, which is shown beside ours for the "
        "first scene: the PSF reaches beyond the sensor, as stitching PSFs from several angles "
        "gives it (the cure that the paper names), and the scene is confined to where light can "
        "come from. Without an aperture, light from the side comes through mask that the sensor's "
        "own PSF never shows, and a model without it explains the measurement wrongly.",
    )
    rows: list[Row] = []
    pictures = []
    for scene in SCENES:
        result = found[f"scene-{scene.name}"]
        key = f"scene {scene.name}"
        if result.refused is not None:
            rows += not_made((key,), result.refused)
            continue
        rows.append(_quality(key, scene, result))
        pictures.append(_picture(scene, result))
    rows += [_exposure(found), _seconds(found)]
    return Draft("photographs", _TITLE, texts, tuple(pictures), tuple(rows))


def _quality(key: str, scene: Scene, result: Found) -> Row:
    figures = result.figures
    rows, columns = figures["region"]
    text = f"PSNR {figures['psnr_db']:.1f} dB, SSIM {figures['ssim']:.2f}"
    why = (
        f"The paper gives no figure of a picture's quality. Against the scene as it reaches the "
        f"sensor, on {columns}×{rows} cells; the measurement's contrast is "
        f"{100 * figures['contrast']:.1f} %."
    )
    if scene.name == SOLVED_AS_PAPER:
        why += (
            f" Solved as the paper does (captured PSF of the sensor's size, no limit of the "
            f"scene, fixed penalties, τ = 10⁻⁴): {figures['papers_psnr_db']:.1f} dB."
        )
    return Row(key, None, text, why, sized=True)


def _picture(scene: Scene, result: Found) -> Drawn:
    arrays = result.arrays
    white = exposure_white(arrays["truth"])
    measurement = _stretched(arrays["measurement"], arrays["truth"])
    panels = [
        Panel(f"the measurement, contrast ×{_STRETCH:g}", measurement, 1.0),
        Panel("the photograph from it", arrays["picture"], white),
        Panel("the scene", arrays["truth"], white),
    ]
    place = f"{scene.angle_deg:g}° at {scene.distance_um * 1e-4:g} cm"
    if "papers" in arrays:
        panels.insert(2, Panel("as the paper solves it", arrays["papers"], white))
    return Drawn(
        f"scene-{scene.name}",
        f"Fig. {scene.name}: {scene.picture}, {place}. The scene is shown as it reaches the "
        "sensor, darker towards its edges.",
        partial(plot_pictures, panels=tuple(panels)),
    )


def _stretched(measurement: Tensor, truth: Tensor) -> Tensor:
    """The middle of the measurement, cut like the scene, every colour about its mean."""
    rows, columns = measurement.shape[-2:]
    height, width = truth.shape[-2:]
    size = min(rows, columns * height // width), min(columns, rows * width // height)
    top, left = (rows - size[0]) // 2, (columns - size[1]) // 2
    part = measurement[:, top : top + size[0], left : left + size[1]]
    mean = part.mean(dim=(-2, -1), keepdim=True)
    return (_GREY * (1 + _STRETCH * (part / mean - 1))).clamp(0, 1)


def _exposure(found: Mapping[str, Found]) -> Row:
    """What exposure a screen of usual brightness needs."""
    given = [
        found[f"scene-{scene.name}"].figures["exposure_cd_s_m2"]
        for scene in SCENES
        if scene.name in _LIGHT and found[f"scene-{scene.name}"].refused is None
    ]
    if not given:
        return Row("exposure", None, "–", "No screen could be photographed with this camera.")
    low, high = (1e3 * each / _SCREEN_CD_M2 for each in (min(given), max(given)))
    dim, bright = (1e3 * min(given) / each for each in (_PAPERS_MS[1], _PAPERS_MS[0]))
    return Row(
        "exposure",
        None,
        f"{low:.0f} ms (60°) to {high:.0f} ms (30°) at {_SCREEN_CD_M2:g} cd/m²",
        "To 90 % of a full pixel, the screen's white as bright as said; the paper does not give "
        f"it. The paper's times fit a 60° scene on a screen of {dim:.0f}–{bright:.0f} cd/m². "
        "The height of the sensor's quantum efficiency is assumed (65 % in green), and absorption "
        "in the resin, a tenth in the paper, is left out.",
    )


def _seconds(found: Mapping[str, Found]) -> Row:
    """The time differs from run to run, so it stands in a file of its own."""
    return Row(
        "seconds",
        None,
        "see timing.json",
        "Seconds differ from run to run, and this report is the same for the same seed: they "
        "stand in timing.json beside it, with the machine. The paper works on 4056×3040 cells, "
        "the full linear convolution; here the period is that of sensor and scene together.",
    )
