"""With deepinv itself: its physics of our operator, its solver and its denoisers beside ours."""

import sys
from collections.abc import Iterator
from importlib import import_module
from importlib.util import find_spec
from types import ModuleType
from unittest.mock import MagicMock

import pytest
import torch

from nolens.errors import OptionError
from nolens.operators import CroppedConvolution, PixelRectangle
from nolens.solvers import (
    Denoiser,
    Gaussian,
    NonNegative,
    Ridge,
    TotalVariation,
    deepinv_denoiser,
    deepinv_physics,
    split_admm,
)

SUPPORT = PixelRectangle(1, 1, 8, 9)

# What deepinv's import takes from torchvision, for its data sets and pictures.
TORCHVISION = (
    "torchvision",
    "torchvision.datasets.folder",
    "torchvision.datasets.utils",
    "torchvision.transforms",
    "torchvision.transforms.functional",
    "torchvision.utils",
)


@pytest.fixture(scope="module")
def deepinv() -> Iterator[ModuleType]:
    """Itself, also where torchvision does not load: nothing that is tested here computes by it."""
    if find_spec("deepinv") is None:
        pytest.skip("needs deepinv (`make env` installs it)")
    with pytest.MonkeyPatch.context() as patch:
        try:
            import_module("torchvision")
        except (ImportError, OSError, RuntimeError):  # One that does not fit torch raises any.
            for name in TORCHVISION:
                patch.setitem(sys.modules, name, MagicMock())
        yield import_module("deepinv")
        # Others would meet a deepinv without its torchvision.
        for name in [name for name in sys.modules if name.split(".")[0] == "deepinv"]:
            del sys.modules[name]


def convolution() -> CroppedConvolution:
    return CroppedConvolution(torch.rand(3, 12, 14).double() ** 8, (12, 14), SUPPORT)


def test_without_deepinv(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "deepinv.physics", None)
    with pytest.raises(OptionError, match=r"pip install 'nolens\[deepinv\]'"):
        deepinv_physics(convolution())
    with pytest.raises(OptionError, match="white is 0"):
        deepinv_denoiser(lambda v, _: v, white=0.0)


def test_a_denoiser_sees_a_batch_between_0_and_1() -> None:
    seen: list[tuple[tuple[int, ...], float, float]] = []

    def model(pictures: torch.Tensor, noise: float) -> torch.Tensor:
        seen.append((tuple(pictures.shape), float(pictures.max()), noise))
        return pictures - noise

    scene = torch.full((2, 3, 4, 5), 50.0)
    out = deepinv_denoiser(model, 2.0, white=50).prox(scene, 1.0)
    assert seen == [((2, 3, 4, 5), 1.0, pytest.approx(0.04))]
    torch.testing.assert_close(out, scene - 2)


@pytest.mark.usefixtures("deepinv")
def test_physics() -> None:
    """Adjoint, norm and least squares by deepinv are those of the operator."""
    a = convolution()
    physics = deepinv_physics(a, max_iter=400, tol=1e-9)
    x = torch.rand(2, 3, 8, 9).double()
    assert float(physics.adjointness_test(x).abs()) < 1e-9
    norm = float(physics.compute_sqnorm(x[:1], tol=1e-6, max_iter=2000))
    assert norm == pytest.approx(a.norm(x[:1], tolerance=1e-8) ** 2, rel=1e-3)
    z = torch.rand_like(x)
    near = physics.prox_l2(z, physics.A(x), gamma=2.0)
    moved = split_admm(2.0 * (Gaussian(a(x - z)) @ a), Ridge(), tolerance=1e-10).scene
    torch.testing.assert_close(near, z + moved, rtol=0, atol=1e-4)


def test_denoiser(deepinv: ModuleType) -> None:
    """Its total variation, as a plugged-in denoiser, is ours with a free border."""
    a = convolution()
    scene = torch.zeros(3, 8, 9).double()
    scene[:, 2:5, 3:7] = 1
    data = Gaussian(a(scene)) @ a

    def plugged(iterations: int) -> Denoiser:
        model = deepinv.models.TVDenoiser(n_it_max=iterations, crit=1e-9, tau=0.1)
        return deepinv_denoiser(lambda v, noise: model(v, 0.05 * noise**2))

    ours = 0.05 * TotalVariation((8, 9), isotropic=True, border="free")
    v = 3 * torch.rand(3, 8, 9).double()
    torch.testing.assert_close(plugged(1000).prox(v, 2.0), ours.prox(v, 2.0), rtol=0, atol=1e-5)
    # Of one step of the solver a few suffice: each goes on from the one before.
    settings = {"penalties": (1.0, 1.0), "balance": None, "iterations": 60, "tolerance": 0.0}
    one, other = (split_admm(data, f, NonNegative(), **settings) for f in (plugged(20), ours))
    assert one.objective == pytest.approx(float(data(one.scene)))
    torch.testing.assert_close(one.scene, other.scene, rtol=0, atol=2e-3)
