"""The measurement in the linear step: the same minimum, and the low frequencies long before."""

from dataclasses import replace

import numpy as np
import pytest
import torch
from posed import Case, pose
from scipy.optimize import minimize

from nolens.camera import FieldPsf
from nolens.errors import OptionError
from nolens.operators import (
    CroppedConvolution,
    FieldConvolution,
    PixelRectangle,
    slow_cosines,
)
from nolens.solvers import Prior, Problem, admm, fista, split_admm
from nolens.solvers.linear_step import _Images, _WaveImages, gram

BASE = Case(view=True, support=PixelRectangle(0, 0, 6, 8))
CASES = {
    "region": replace(BASE, saturated=0.1),
    "region partly off": replace(BASE, psf=(9, 9), support=PixelRectangle(-2, 3, 6, 8)),
    "a scene of two rows": replace(BASE, support=PixelRectangle(2, 1, 2, 5)),
    "without a support": replace(BASE, support=None, channels=2, saturated=0.1),
    "two channels of one psf": replace(BASE, channels=2, psf_channels=1),
    "isotropic": replace(BASE, sensor=(5, 7), psf=(5, 7), prior="isotropic-tv"),
    "l1": replace(BASE, channels=3, prior="l1", saturated=0.1),
    "no prior": replace(BASE, prior="none", support=PixelRectangle(1, 1, 4, 5), seed=3),
}


def test_inner_products_of_rows_that_are_nearly_alike():
    """In float32 their matrix would not be positive, and ADMM would diverge on it."""
    generator = torch.Generator().manual_seed(0)
    rows = torch.rand((1, 50_000), generator=generator) + 1
    rows = rows + 1e-4 * torch.rand((8, 50_000), generator=generator)
    weights = torch.rand(50_000, generator=generator)
    truth = np.linalg.eigvalsh(
        np.einsum("ip,p,jp->ij", *(x.double() for x in (rows, weights, rows)))
    )
    np.testing.assert_allclose(np.linalg.eigvalsh(gram(rows, weights)), truth, rtol=1e-4)
    assert truth[0] < 1e-9 * truth[-1]


@pytest.mark.parametrize("case", CASES.values(), ids=CASES.keys())
def test_reaches_the_minimum(case):
    """That of a long run of the plain algorithm."""
    posed = pose(case)
    references = [posed.reference(k) for k in range(case.channels)]
    lowest = [r.minimum() for r in references]
    objective = np.mean([r.objective(w) for r, w in zip(references, lowest, strict=True)])
    scenes = np.array([r.scene(w) * r.scale for r, w in zip(references, lowest, strict=True)])
    result = admm(posed.problem, iterations=300, tolerance=1e-5, low_frequency=True)
    assert result.objective == pytest.approx(objective, rel=1e-3, abs=2e-6)
    assert np.linalg.norm(result.scene.numpy() - scenes) <= 0.05 * np.linalg.norm(scenes)


def test_colours_together_against_the_generic_solver():
    """And the start: the solver takes the colours together where they fill the view."""
    posed = pose(replace(BASE, channels=3, saturated=0.1))
    problem = posed.pose(prior="auto")
    assert problem.prior is Prior.COLOUR_TV
    other = split_admm(*problem.functionals, iterations=300, tolerance=1e-7)
    result = admm(problem, iterations=200, tolerance=1e-5)
    assert result.objective == pytest.approx(other.objective / 3, rel=1e-3)
    error = torch.linalg.vector_norm(result.scene / problem.scale - other.scene)
    assert error <= 0.02 * torch.linalg.vector_norm(other.scene)
    _, lower = problem.gain_corrected(1.1 * other.scene)
    assert lower == pytest.approx(other.objective / 3, rel=1e-3)
    apart = pose(replace(Case(), channels=3)).pose(prior="auto")
    assert apart.prior is Prior.TV
    with pytest.raises(OptionError, match="three colours, and the measurement has 1 channel"):
        pose(BASE).pose(prior="colour-tv")


def shaded() -> tuple[torch.Tensor, Problem]:
    """A shaded scene through a broad PSF, the glow of an open mask, without noise."""
    generator = torch.Generator().manual_seed(2)
    sensor, side = (96, 112), 48
    away = torch.hypot(torch.arange(160)[:, None] - 80.0, torch.arange(176) - 88.0)
    texture = torch.rand(1, 160, 176, generator=generator) ** 6
    psf = torch.exp(-((away / 80) ** 2)) * (1 + 0.2 * texture)
    rows, columns = torch.meshgrid(*[torch.linspace(0, 1, side)] * 2, indexing="ij")
    truth = (0.3 + 0.7 * rows * columns + 0.2 * torch.cos(6 * rows))[None]
    support = PixelRectangle.centred(side, side, sensor)
    problem = Problem.build(
        psf, CroppedConvolution(psf, sensor, support)(truth), support=support, tau=1e-7
    )
    return truth, problem


def test_finds_a_shading_at_once():
    truth, problem = shaded()

    def error(iterations: int, low_frequency: bool) -> float:
        scene = admm(problem, iterations=iterations, tolerance=0, low_frequency=low_frequency).scene
        return float(torch.linalg.vector_norm(scene - truth))

    assert error(12, low_frequency=True) < 0.2 * error(200, low_frequency=False)


def test_light_that_leans_matters_only_where_slow_light_counts():
    """A sensor that gets a thousandth more light on one edge: errors of one PSF are larger."""
    _, problem = shaded()
    columns = torch.arange(112)
    lean = 1e-3 * torch.cos(torch.pi * (columns + 0.5) / 112) * problem.data.mean()
    valid = columns.expand_as(problem.data) % 17 > 0

    def change(slow_light: bool) -> float:
        upright = replace(problem, data=problem.data * valid, valid=valid, slow_light=slow_light)
        leaning = replace(upright, data=(problem.data + lean) * valid)
        one, other = (
            admm(each, iterations=20, tolerance=0, low_frequency=True).scene
            for each in (upright, leaning)
        )
        return float(torch.linalg.vector_norm(other - one) / torch.linalg.vector_norm(one))

    assert change(slow_light=False) < 1e-3
    assert change(slow_light=True) > 0.02


def test_the_minimum_without_slow_light():
    """Against a generic solver, of colours together."""
    problem = replace(
        pose(replace(BASE, channels=3, saturated=0.1)).pose(prior="colour-tv"), slow_light=False
    )
    other = split_admm(*problem.functionals, iterations=300, tolerance=1e-7)
    result = admm(problem, iterations=200, tolerance=1e-5)
    assert result.objective == pytest.approx(other.objective / 3, rel=1e-3)
    assert result.objective < 0.99 * admm(replace(problem, slow_light=True)).objective


@pytest.mark.parametrize("prior", ["none", "l1"])
@pytest.mark.parametrize("level", [0.0, 0.5], ids=["points in the dark", "fills the view"])
def test_psfs_over_the_field(prior, level):
    """Against a bounded quasi-Newton method in float64, of the operator written as a matrix."""
    generator = torch.Generator().manual_seed(5)
    psfs = torch.rand((3, 1, 13, 15), generator=generator) ** 4
    field_psf = FieldPsf(psfs, torch.tensor([(-2.0, -3), (2, -3), (1, 3)]))
    support = PixelRectangle(1, 1, 5, 6)
    scene = level + torch.rand((1, 5, 6), generator=generator).pow(8)
    places = field_psf.places + torch.tensor([4, 5])
    data = FieldConvolution(psfs, places, (8, 10), support)(scene)
    data += 0.01 * data.max() * torch.randn(data.shape, generator=generator)
    problem = Problem.build(
        psfs[0], data, support=support, tau=3e-3, prior=prior, field_psf=field_psf
    )
    pixels = torch.eye(30).view(30, 1, 5, 6)
    matrix = problem.forward(pixels).flatten(1).double().numpy().T
    b = problem.data.double().flatten().numpy()
    tau = 0.0 if prior == "none" else 3e-3

    def objective(v):
        left = matrix @ v - b
        return 0.5 * left @ left + tau * v.sum(), matrix.T @ left + tau

    lowest = minimize(
        objective,
        np.zeros(30),
        jac=True,
        method="L-BFGS-B",
        bounds=[(0, None)] * 30,
        options={"ftol": 1e-15, "gtol": 1e-10, "maxiter": 5000},
    )
    result = admm(problem, iterations=2000, tolerance=1e-5)
    assert result.objective == pytest.approx(lowest.fun, rel=1e-3, abs=2e-6)
    expected = lowest.x.reshape(5, 6) * float(problem.scale)
    assert np.linalg.norm(result.scene[0].numpy() - expected) <= 0.02 * np.linalg.norm(expected)
    other = fista(problem, iterations=3000, tolerance=1e-7)
    assert other.objective == pytest.approx(lowest.fun, rel=1e-3, abs=2e-6)


def test_points_in_the_dark_are_sharp_soon():
    """Nearly at the minimum after 40 iterations: penalties do not hold what A hardly sees."""
    generator = torch.Generator().manual_seed(3)

    def points(count, size):
        plane = torch.zeros(size)
        at = (torch.rand(count, 2, generator=generator) * torch.tensor(size)).long()
        plane[at[:, 0], at[:, 1]] = torch.rand(count, generator=generator) + 0.5
        return plane[None]

    along = torch.exp(-((torch.arange(7) - 3.0) ** 2) / 2)
    lenslets = torch.stack([points(30, (57, 61)) for _ in range(3)])
    psfs = torch.conv2d(lenslets, torch.outer(along, along)[None, None], padding=3)
    field_psf = FieldPsf(psfs, torch.tensor([(-15.0, -15), (15, -15), (0, 15)]))
    sensor, truth = (24, 28), points(10, (32, 32))
    support = PixelRectangle.centred(32, 32, sensor)
    places = field_psf.places + torch.tensor([12, 14])
    data = FieldConvolution(psfs, places, sensor, support)(truth)
    data += 0.01 * data.max() * torch.randn(data.shape, generator=generator)
    problem = Problem.build(
        psfs[0], data, support=support, tau=1e-5, prior="l1", field_psf=field_psf
    )
    lowest = fista(problem, iterations=200, tolerance=0).objective
    assert admm(problem, iterations=40, tolerance=0).objective < 1.5 * lowest


def test_is_left_alone_where_the_scene_does_not_fill_the_view():
    problem = pose(replace(Case(), support=PixelRectangle(1, 2, 4, 5))).problem
    plain = admm(problem, iterations=30, tolerance=0)
    assert torch.equal(
        admm(problem, iterations=30, tolerance=0, low_frequency=True).scene, plain.scene
    )


def test_steps_among_spectra_are_those_among_pixels():
    """One PSF without a support, and the same as that of a field, which takes pixels."""
    posed = pose(replace(BASE, support=None, channels=2, saturated=0.1))
    alike = FieldPsf(torch.from_numpy(posed.psf[None]).float(), torch.zeros(1, 2))
    one, other = (
        admm(each, iterations=6, tolerance=0, low_frequency=True).scene
        for each in (posed.problem, posed.pose(field_psf=alike))
    )
    assert torch.linalg.vector_norm(other - one) <= 1e-4 * torch.linalg.vector_norm(one)


@pytest.mark.parametrize("slow_light", [True, False])
def test_images_of_cosines_without_a_support_are_few_waves(slow_light):
    """Against the images themselves; the PSF is larger than the sensor."""
    case = replace(BASE, support=None, sensor=(30, 34), psf=(60, 47), saturated=0.1)
    problem = replace(pose(case).problem, slow_light=slow_light)
    rows, columns = (slow_cosines(side).float() for side in problem.scene_shape[1:])
    light = list(problem.forward.of_products(rows, columns))
    images = _Images(problem, iter(light), len(light))
    waves = _WaveImages(problem, iter(light))
    image, amounts = problem.counted(torch.rand(1, 30, 34)), torch.rand(9)
    for one, other in (
        (images.gram, waves.gram),
        (images.along(image), waves.along(image)),
        (images.sum(amounts), waves.sum(amounts)),
    ):
        assert torch.linalg.vector_norm(other - one) <= 1e-5 * torch.linalg.vector_norm(one)
