"""What is said of a PSF and a measurement that do not belong together; good ones are silent."""

from dataclasses import replace

import pytest
import torch
import torch.nn.functional as nnf
from skimage import data as photographs
from torch import Tensor

from nolens.camera import FieldPsf, Measurement
from nolens.operators import CroppedConvolution, FieldConvolution, PixelRectangle
from nolens.optics.magnification import magnified
from nolens.solvers import Method, Reconstructor
from nolens.solvers.explanation import choose_field, explain, picture_warnings
from nolens.solvers.problem import Prior
from nolens.solvers.result import Stop

SENSOR = (192, 224)
SUPPORT = PixelRectangle.centred(64, 64, SENSOR)


def mask_psf(seed: int = 0, *, aperture: bool = True) -> Tensor:
    """Fine random lines, like a caustic's, behind an aperture or up to the edges."""
    noise = torch.randn(1, 1, *SENSOR, generator=torch.Generator().manual_seed(seed))
    smooth = nnf.avg_pool2d(nnf.avg_pool2d(noise, 7, 1, 3), 5, 1, 2)
    lines = torch.exp(-((smooth / 0.01).square()))[0]
    if not aperture:
        return lines
    return nnf.pad(lines[:, 32:-32, 40:-40], (40, 40, 32, 32))


def out_of_focus(psf: Tensor) -> Tensor:
    return nnf.avg_pool2d(nnf.avg_pool2d(psf, 7, 1, 3), 7, 1, 3)


def photograph() -> Tensor:
    encoded = torch.as_tensor(photographs.camera()).float()[None, None] / 255
    return nnf.interpolate(encoded, size=(64, 64), mode="bilinear", antialias=True)[0]


def measured(psf: Tensor | CroppedConvolution, noise: float = 0.01) -> Measurement:
    operator = CroppedConvolution(psf, SENSOR, SUPPORT) if isinstance(psf, Tensor) else psf
    light = operator(photograph())
    light /= light.square().mean().sqrt()
    values = light + noise * torch.randn(light.shape)
    return Measurement(values, torch.ones_like(values, dtype=torch.bool), ("grey",), None, "raw")


def said(
    psf: Tensor,
    data: Measurement,
    support: PixelRectangle | None = SUPPORT,
    *,
    stated: bool = True,
) -> str:
    solver = Reconstructor(psf, support, tau=1e-4)
    return " ".join(
        explain(
            solver, data, None, "psf", support_by="person" if stated else "measurement"
        ).warnings
    )


@pytest.mark.parametrize("noise", [0.003, 0.03, 0.2])
@pytest.mark.parametrize("support", [SUPPORT, None])
def test_good_problems_are_silent(noise: float, support: PixelRectangle | None) -> None:
    psf = mask_psf()
    assert said(psf, measured(psf, noise), support) == ""


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda psf: magnified(psf, 1.025), ("3 % smaller", "farther", "nolens refocus")),
        (lambda psf: magnified(psf, 0.97), ("3 % larger", "nearer")),
        (lambda psf: psf.flip(-1), ("not explained by the PSF psf", "refocused or moved")),
        (lambda psf: mask_psf(1), ("noise alone would be", "another camera")),
        (out_of_focus, ("sharper", "out of focus")),
    ],
)
def test_another_psf(change, words) -> None:  # type: ignore[no-untyped-def]
    psf = mask_psf()
    text = said(change(psf), measured(psf))
    for word in words:
        assert word in text


def test_psfs_over_the_field() -> None:
    """They are used where they are the camera's, and one where its PSF is the same everywhere."""
    places = torch.tensor([(0, 0), (-32, -32), (-32, 32), (32, -32), (32, 32)])
    field_psf = FieldPsf.of([mask_psf(seed) for seed in range(5)], places)
    middle = torch.tensor([side // 2 for side in SENSOR])
    varied = FieldConvolution(field_psf.values, places + middle, SENSOR, SUPPORT)
    solver = Reconstructor(field_psf.on_axis, SUPPORT, field_psf=field_psf)
    kept = choose_field(solver, measured(varied))
    assert kept.reconstructor is solver and kept.warnings == () and kept.left_out == 0
    one = mask_psf()
    choice = choose_field(replace(solver, psf=mask_psf(1)), measured(one), one)
    assert choice.reconstructor.field_psf is None and choice.left_out == 5
    assert choice.reconstructor.psf is one
    assert "--field-points 5" in choice.warnings[0] and "calibrate plan" in choice.warnings[0]
    assert choice.row()["unexplained_by_one"] < 0.1 < choice.row()["unexplained"]


def test_support_that_is_too_small() -> None:
    psf = mask_psf()
    text = said(psf, measured(psf), PixelRectangle.centred(48, 48, SENSOR))
    assert "support of 48×48 pixels" in text and "comes from beyond it" in text
    assert "refocused" not in text
    # Seen through noise, by comparison; how much the PSF explains is not, and so both are named.
    noisy = measured(psf, 0.3)
    text = said(psf, noisy, PixelRectangle.centred(48, 48, SENSOR))
    assert "Without the support of 48×48 pixels" in text
    assert "is the scene larger, or beside it?" in text and "If it is not, was the camera" in text
    assert said(psf, noisy) == ""
    # Of a PSF with light up to the edges, no support would explain anything.
    small = PixelRectangle.centred(48, 48, SENSOR)
    wide = mask_psf(aperture=False)
    data = measured(wide)
    text = said(wide, data, small)
    place = text.index("is the scene larger than its stated support of 48×48 pixels")
    assert place < text.index("was the camera refocused or moved")
    assert "stated" not in said(wide, data, small, stated=False)
    assert said(wide, data) == ""


def test_files_that_are_exchanged() -> None:
    """A scene of a few points, whose measurement is as fine as its PSF."""
    psf = mask_psf()
    points = torch.zeros(1, 64, 64)
    points[0, 10, 40] = points[0, 30, 12] = 1
    points[0, 50, 30] = 2
    light = CroppedConvolution(psf, SENSOR, SUPPORT)(points)
    data = replace(measured(psf), values=light / light.max() + 0.002 * torch.rand(light.shape))
    assert said(psf, data) == ""
    swapped = replace(data, values=psf / psf.max(), source="psf")
    text = said(data.values, swapped, None)
    assert "exchanged" in text and "swapped" in text


def test_what_noise_hides_and_what_is_too_small_to_judge() -> None:
    psf = mask_psf()
    assert said(psf.flip(-1), measured(psf, 3.0)) == ""
    dark = measured(psf)
    for seed in range(4):
        noise = torch.randn(dark.values.shape, generator=torch.Generator().manual_seed(seed))
        alone = said(psf, replace(dark, values=noise + 256), None)
        assert "raw shows nothing of a scene above its noise" in alone
    data = measured(psf)
    small = replace(data, values=data.values[:, :20, :20], valid=data.valid[:, :20, :20])
    assert explain(Reconstructor(psf, None, tau=1e-4), small, None, "psf").prediction is None
    # Another prior or none is judged all the same, and the filter by its own prediction alone.
    wrong = Reconstructor(psf.flip(-1), SUPPORT, tau=1e-4, prior=Prior.NONE)
    assert explain(wrong, data, None, "psf").warnings
    filtered = Reconstructor(psf.flip(-1), SUPPORT, method=Method.WIENER)
    assert explain(filtered, data, filtered.choose_weight(data), "psf").warnings


def test_what_is_said_of_a_picture() -> None:
    """A run that was ended early, and a scene that fills the view; silence of a good one."""
    psf = mask_psf()
    early = Stop(8, 0.0, 0.0, low_frequency=False)

    def said_of(support: PixelRectangle | None, data: Tensor, stop: Stop | None = None) -> str:
        problem = Reconstructor(psf, support, tau=1e-4).problem(data)
        result = Reconstructor(psf, support, tau=1e-4, stop=stop).solve(problem)
        assert picture_warnings(problem, result, psf, iterations=8) == ()
        return " ".join(picture_warnings(problem, result, psf, None))

    values = measured(psf).values
    text = said_of(None, values, early)
    assert "8 iterations" in text and "--support" in text
    assert said_of(None, values) == said_of(SUPPORT, values) == ""
    # A network makes a number of turns that is known, and iterations would leave it out.
    problem = Reconstructor(psf, None, tau=1e-4).problem(values)
    first = Reconstructor(psf, None, tau=1e-4, stop=early).solve(problem)
    (of_network,) = picture_warnings(problem, replace(first, first=first), psf, None)
    assert "8 iterations" in of_network and "--iterations" not in of_network
    wide = CroppedConvolution(psf, SENSOR, None)
    everywhere = wide(torch.ones(1, *wide.geometry.scene[2:])) + values
    soon = Stop(16, 0.0, 0.0, low_frequency=True)
    assert "the scene fills the view" in said_of(None, everywhere, soon)
