"""Weight and recovery of the live view's solver, with a simulated camera whose scene jumps."""

from pathlib import Path
from types import SimpleNamespace

import pytest
import torch

from nolens.camera import FieldPsf, Frame, LoadedCamera, Measurement, preset
from nolens.evaluate import psnr, scale_fit
from nolens.files import write_camera
from nolens.operators import CroppedConvolution, FieldConvolution, PixelRectangle
from nolens.solvers import FieldPoint, Reconstructor
from nolens.studio import live_camera
from nolens.studio.live_solver import LiveSolver
from nolens.studio.schemas import Settings
from nolens.twin import acceptance_support, preview_model

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


@pytest.mark.parametrize(("frame_s", "prior"), [(100.0, "denoiser"), (1e-6, "tv")])
def test_recovers_from_a_cut_within_three_frames(monkeypatch, frame_s: float, prior: str) -> None:
    """The third picture of another scene is as good, to 1 dB, as a cold run of that frame with the
    iterations of all three; and it is of that scene. Before, the picture was by the trained prior
    where its frames take less than the time that they have.
    """
    monkeypatch.setattr("nolens.studio.live_stream._TRAINED_S", frame_s)
    psf, blur = _camera()
    solver, settings = LiveSolver(psf, _SUPPORT), Settings()
    plain = LiveSolver(psf, _SUPPORT)
    for number in range(10):
        frame = _frame(blur, _scene(1), number)
        live = solver.solve(frame, settings, 1.0)
        without = plain.solve(frame, Settings(trained=False), 1.0)
        for each in (solver, plain):
            each.await_choices()
        assert live.prior["prior"] == (prior if number > 7 else "tv")
    assert without.prior == {"prior": "tv"}
    assert torch.equal(live.radiance, without.radiance) == (prior == "tv")
    assert _quality(live.radiance, _scene(1)) > 40
    for number in range(3):
        frame = _frame(blur, 3 * _scene(2), 100 + number)
        live = solver.solve(frame, settings, 1.0)
        assert live.prior == {"prior": "tv"}
    assert live.iterations == settings.iterations
    cold = Reconstructor(psf, _SUPPORT).for_iterations(3 * settings.iterations).solve(frame)
    recovered = _quality(live.radiance, _scene(2))
    assert recovered > max(20, _quality(cold.photograph, _scene(2)) - 1)
    assert recovered > _quality(live.radiance, _scene(1)) + 5


def test_psfs_over_the_field(monkeypatch) -> None:
    """All are better than their mean or one, and are the stream's of the same."""
    monkeypatch.setattr("nolens.studio.live_stream._LATENCY_S", None)
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
        solver.await_choices()
        quality[name] = _quality(live.radiance, _scene(1))
    assert live.field_points == 5 and torch.equal(live.radiance, expected)
    assert quality["all"] > 1 + max(quality["one"], quality["mean"])


def test_weight_is_chosen_beside_the_frames_and_divided_by_the_detail() -> None:
    psf, blur = _camera()
    solver = LiveSolver(psf, _SUPPORT)
    frame = _frame(blur, _scene(1), 0)
    chosen = Reconstructor(psf, _SUPPORT).choose_weight(frame).tau
    solver.solve(frame, Settings(), 1.0)
    solver.await_choices()
    assert solver.solve(frame, Settings(), 1.0).tau == chosen
    assert solver.solve(frame, Settings(detail=4), 1.0).tau == chosen / 4
    assert solver.solve(frame, Settings(method="wiener"), 1.0).tau > 0


def test_light_comes_from_what_the_camera_accepts(monkeypatch) -> None:
    """Pictures are then those with that support, dark around it; where light comes from beyond,
    they stay those without any.
    """
    monkeypatch.setattr("nolens.studio.live_stream._LATENCY_S", None)
    psf, blur = _camera()
    frame, asked = _frame(blur, _scene(1), 0), []

    def acceptance(by: int, size: tuple[int, int], given: torch.Tensor) -> PixelRectangle:
        asked.append((by, size, given))
        return _SUPPORT

    solver = LiveSolver(psf, acceptance=acceptance)
    assert solver.solve(frame, Settings(), 1.0).radiance.shape[1:] == _SENSOR
    solver.await_choices()
    assert asked == [(1, _SENSOR, psf)]
    filtered = Settings(method="wiener")
    own = _picture(LiveSolver(psf, _SUPPORT), frame, filtered)
    assert torch.equal(_picture(solver, frame, filtered), _around(own))
    live = solver.solve(frame, Settings(), 1.0)
    stream = Reconstructor(psf, _SUPPORT, 0.0).stream(frame, iterations=2)
    stream.weigh(live.tau)
    assert torch.equal(live.radiance, _around(stream.solve(frame.values).photograph))

    far = CroppedConvolution(psf, _SENSOR, PixelRectangle(2, 3, 40, 56))
    beyond = _frame(far, _scene(1), 0)
    solver = LiveSolver(psf, acceptance=acceptance)
    solver.solve(beyond, Settings(), 1.0)
    solver.await_choices()
    free = _picture(LiveSolver(psf), beyond, filtered)
    assert len(asked) == 2
    assert torch.equal(_picture(solver, beyond, filtered), free)


def _picture(solver: LiveSolver, frame: Measurement, settings: Settings) -> torch.Tensor:
    """Of a frame; nothing goes on in a thread beside it afterwards."""
    picture = solver.solve(frame, settings, 1.0).radiance
    solver.await_choices()
    return picture


def _around(picture: torch.Tensor) -> torch.Tensor:
    """A picture of the support in a dark one of the sensor's size."""
    whole = torch.zeros(len(picture), *_SENSOR)
    rows = slice(_SUPPORT.top, _SUPPORT.top + _SUPPORT.height)
    whole[:, rows, _SUPPORT.left : _SUPPORT.left + _SUPPORT.width] = picture
    return whole


def test_acceptance_is_of_the_camera_beside_the_psf(tmp_path: Path) -> None:
    psf = torch.ones(1, 380, 507)
    write_camera(tmp_path / "mine", preset("paper"))
    twin = preview_model(LoadedCamera.of(preset("paper")))
    expected = acceptance_support(twin, None).coarser(4)
    assert live_camera._acceptance(tmp_path / "mine", 4, (380, 507), psf) == expected
    assert live_camera._acceptance(tmp_path / "mine", 4, (190, 253), psf) is None
    assert live_camera._acceptance(tmp_path, 4, (380, 507), psf) is None


def test_psf_of_a_twin_is_on_the_pixels_of_its_frames() -> None:
    """Also where it has more rows than the sensor."""
    camera = LoadedCamera.of(preset("paper"))
    source = SimpleNamespace(
        psf=lambda: torch.rand(1, 1741, 2319),
        support=PixelRectangle.centred(220, 292, (1520, 2028)),
    )
    solver = live_camera._twin_solver(source, camera)
    frame = Measurement(torch.rand(1, 380, 507), torch.ones(1, 380, 507) > 0, ("grey",), None, "")
    assert _picture(solver, frame, Settings(method="wiener")).shape[1:] == (55, 73)
