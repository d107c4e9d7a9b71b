"""Weight and recovery of the live view's solver, with a simulated camera whose scene jumps."""

import torch

from nolens.camera import FieldPsf, Frame, Measurement
from nolens.evaluate import psnr, scale_fit
from nolens.operators import CroppedConvolution, FieldConvolution, PixelRectangle
from nolens.solvers import FieldPoint, Reconstructor
from nolens.studio.live_solver import LiveSolver
from nolens.studio.schemas import Settings

_SENSOR = (96, 128)
_SUPPORT = PixelRectangle.centred(40, 56, _SENSOR)
_NOISE = 0.01


def _camera() -> tuple[torch.Tensor, CroppedConvolution]:
    generator = torch.Generator().manual_seed(1)
    psf = (torch.rand(1, 120, 150, generator=generator) > 0.98).float()
    return psf, CroppedConvolution(psf, _SENSOR, _SUPPORT)


def _scene(seed: int) -> torch.Tensor:
    """Rectangles of light, others for each seed."""
    generator = torch.Generator().manual_seed(seed)
    scene = torch.full((1, 40, 56), 0.1)
    for _ in range(6):
        top, left, height, width = (torch.rand(4, generator=generator) * 24 + 4).int().tolist()
        scene[:, top : top + height, left : left + width] = float(
            torch.rand(1, generator=generator)
        )
    return scene


def _frame(blur: CroppedConvolution, scene: torch.Tensor, seed: int) -> Measurement:
    light = blur(scene)
    generator = torch.Generator().manual_seed(seed)
    noise = _NOISE * light.mean() * torch.randn(light.shape, generator=generator)
    return Measurement(light + noise, torch.ones_like(light, dtype=torch.bool), ("grey",), None, "")


def _quality(picture: torch.Tensor, scene: torch.Tensor) -> float:
    return psnr(scale_fit(picture, scene), scene, float(scene.max()))


def test_recovers_from_a_cut_within_three_frames() -> None:
    """The third picture of another scene is as good, to 1 dB, as a cold run of that frame with the
    iterations of all three; and it is of that scene.
    """
    psf, blur = _camera()
    solver, settings = LiveSolver(psf, _SUPPORT), Settings()
    for number in range(8):
        solver.solve(_frame(blur, _scene(1), number), settings, 1.0)
    for number in range(3):
        frame = _frame(blur, _scene(2), 100 + number)
        live = solver.solve(frame, settings, 1.0)
    assert live.iterations == settings.iterations
    cold = Reconstructor(psf, _SUPPORT).for_iterations(3 * settings.iterations).solve(frame)
    recovered = _quality(live.radiance, _scene(2))
    assert recovered > max(20, _quality(cold.photograph, _scene(2)) - 1)
    assert recovered > _quality(live.radiance, _scene(1)) + 5


def test_psfs_over_the_field(monkeypatch) -> None:
    """All are better than their mean or one, and are the stream's of the same."""
    monkeypatch.setattr("nolens.studio.live_solver._LATENCY_S", None)
    generator = torch.Generator().manual_seed(3)
    shared, own = (torch.rand(5, 1, 120, 150, generator=generator) > 0.98).float(), 0.6
    psfs = shared[:1].lerp(shared, own)
    places = torch.tensor([(0.0, 0), (-15, -20), (-15, 20), (15, -20), (15, 20)])
    middle = torch.tensor([side // 2 for side in _SENSOR])
    blur = FieldConvolution(psfs, places + middle, _SENSOR, _SUPPORT)
    points = tuple(
        FieldPoint(Frame(psf, ("grey",), None, (0.0,), None, "float32", "", sensor=_SENSOR), (y, x))
        for psf, (y, x) in zip(psfs, places.tolist(), strict=True)
    )
    whole = Reconstructor(
        psfs[0], _SUPPORT, 0.0, field_psf=FieldPsf.of([*psfs], places), basis_error=0.08
    )
    frames = [_frame(blur, _scene(1), number) for number in range(4)]
    quality = {}
    for name, given, over_field in (
        ("one", (), False),
        ("mean", points, False),
        ("all", points, True),
    ):
        solver = LiveSolver(points[0].frame, _SUPPORT, given)
        stream = whole.stream(frames[0], iterations=2)
        for frame in frames:
            live = solver.solve(frame, Settings(over_field=over_field), 1.0)
            stream.weigh(live.tau)
            expected = stream.solve(frame.values).photograph
        solver.await_weights()
        quality[name] = _quality(live.radiance, _scene(1))
    assert live.field_points == 5 and torch.equal(live.radiance, expected)
    assert quality["all"] > 1 + max(quality["one"], quality["mean"])


def test_weight_is_chosen_beside_the_frames_and_divided_by_the_detail() -> None:
    psf, blur = _camera()
    solver = LiveSolver(psf, _SUPPORT)
    frame = _frame(blur, _scene(1), 0)
    chosen = Reconstructor(psf, _SUPPORT).choose_weight(frame).tau
    solver.solve(frame, Settings(), 1.0)
    solver.await_weights()
    assert solver.solve(frame, Settings(), 1.0).tau == chosen
    assert solver.solve(frame, Settings(detail=4), 1.0).tau == chosen / 4
    assert solver.solve(frame, Settings(method="wiener"), 1.0).tau > 0
