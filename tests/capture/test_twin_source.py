"""The simulated camera as a live one: noise, exposure, pace, and pictures of its frames."""

import math
import subprocess
import sys
import threading
import time

import pytest
import torch

from nolens.camera import LoadedCamera, develop, preset
from nolens.capture import CameraSource, Levels, TwinSource, chart, open_source
from nolens.errors import CameraError, DataError, NolensError, OptionError
from nolens.evaluate import psnr, scale_fit
from nolens.solvers import Problem, admm, wiener
from nolens.twin import FieldMap, FieldModel, Light, Twin


@pytest.fixture(scope="module")
def worked_out() -> TwinSource:
    source = open_source("twin:live")
    assert isinstance(source, TwinSource)
    source.open()
    return source


@pytest.fixture
def source(worked_out: TwinSource) -> TwinSource:
    worked_out.show(chart())
    worked_out.open()
    worked_out.set(exposure_s=0.02, gain=1.0)
    return worked_out


def test_it_is_a_camera_source(source: TwinSource) -> None:
    camera: CameraSource = source
    shot = camera.shot()
    assert (shot.camera, shot.exposure_s, shot.gain) == ("twin of live", 0.02, 1.0)
    frame = shot.frame
    assert frame.counts.shape == (1, 720, 960) and frame.counts.dtype == torch.float32
    assert (frame.mosaic, frame.black, frame.exposure_s) == ("RGGB", (256.0,), 0.02)
    assert bool((frame.counts == frame.counts.round()).all())
    assert shot.taken.utcoffset() is not None


def test_counts_follow_exposure_gain_and_saturate(source: TwinSource) -> None:
    means = {}
    for exposure_s, gain in ((0.006, 1.0), (0.012, 1.0), (0.006, 3.0)):
        source.set(exposure_s=exposure_s, gain=gain)
        shot = source.shot()
        assert Levels.of(shot.frame).clipped_fraction == 0
        means[exposure_s, gain] = float(shot.frame.counts.mean()) - 256
    assert means[0.012, 1.0] == pytest.approx(2 * means[0.006, 1.0], rel=5e-3)
    assert means[0.006, 3.0] == pytest.approx(3 * means[0.006, 1.0], rel=5e-3)
    source.set(exposure_s=1.0, gain=16.0)
    frame = source.shot().frame
    assert Levels.of(frame).clipped_fraction > 0.5
    assert float(frame.counts.max()) <= 4095


def test_noise_is_that_of_electrons_and_of_reading(source: TwinSource) -> None:
    counts = torch.stack([source.shot().frame.counts[0] for _ in range(12)]).double()
    mean, variance = counts.mean(dim=0) - 256, counts.var(dim=0)
    sensor_read, per_electron = 3.0, 0.47
    for low, high in ((0, 20), (200, 400), (800, 1200)):
        cells = (mean > low) & (mean <= high)
        assert int(cells.sum()) > 2000
        electrons = float(mean[cells].mean()) / per_electron
        # Of electrons, of reading, and of rounding to whole counts.
        expected = per_electron**2 * (electrons + sensor_read**2) + 1 / 12
        assert float(variance[cells].mean()) == pytest.approx(expected, rel=0.04)


def test_it_takes_the_time_of_a_camera(source: TwinSource) -> None:
    source.shot()
    for exposure_s, least_s in ((0.15, 0.15), (0.001, 1 / 30)):
        source.set(exposure_s=exposure_s, gain=1.0)
        begun = time.monotonic()
        for _ in range(3):
            source.shot()
        assert time.monotonic() - begun >= 3 * least_s - 0.01


def test_a_reconstruction_shows_the_scene(source: TwinSource) -> None:
    measured = develop(source.shot().frame)
    truth = source.truth()

    def posed(tau: float) -> Problem:
        return Problem.build(
            source.psf(), measured.values, valid=measured.valid, support=source.support, tau=tau
        )

    quick = wiener(posed(3.0)).scene
    picture = admm(posed(1e-4), iterations=10, tolerance=0.0).scene
    assert psnr(scale_fit(quick, truth), truth, 1.0) > 20.5
    assert psnr(scale_fit(picture, truth), truth, 1.0) > 21.5
    # One scale fits all colours: the PSF is in electrons of the same light.
    lit = truth.amax(dim=0) > 0.3
    shares = [float(picture[c][lit].sum() / truth[c][lit].sum()) for c in range(3)]
    assert max(shares) < 1.05 * min(shares)


def test_light_of_the_whole_field_stays_on_the_sensor() -> None:
    camera = preset("live")
    twin = Twin.of(LoadedCamera.of(camera))
    edge = math.tan(math.radians(20.0))
    field = FieldMap.covering(twin, (0.75 * edge, edge))
    model = FieldModel.of(twin, field, distance_um=300e3, light=Light("white-led"), wavelengths=1)
    weights = field.solid_angle() * field.vignetting()

    def caught(row: int, column: int) -> float:
        point = torch.zeros(3, field.support.height, field.support.width)
        point[:, row, column] = 1.0
        return float(model.light(point).double().sum()) / float(weights[row, column])

    middle = caught(field.support.height // 2, field.support.width // 2)
    for corner in ((0, 0), (0, -1), (-1, 0), (-1, -1)):
        assert caught(*corner) > 0.95 * middle


def test_another_scene_from_another_thread(source: TwinSource) -> None:
    before = source.shot().frame.counts
    black = threading.Thread(target=source.show, args=(torch.zeros(3, 9, 9),))
    black.start()
    black.join()
    after = source.shot().frame.counts
    assert float(before.mean()) > 260
    assert float(after.mean()) == pytest.approx(256, abs=0.05)
    source.show_point()
    lit = develop(source.shot().frame).values.mean(dim=0)
    aside = source.psf().mean(dim=0)
    assert torch.corrcoef(torch.stack([lit.flatten(), aside.flatten()]))[0, 1] > 0.9


def test_what_is_no_scene_is_refused(source: TwinSource) -> None:
    for scene in (torch.zeros(9, 9), torch.zeros(1, 9, 9), torch.full((3, 2, 2), -1.0),
                  torch.full((3, 2, 2), float("nan")), torch.zeros(3, 0, 4)):  # fmt: skip
        with pytest.raises(DataError):
            source.show(scene)
    assert float(source.shot().frame.counts.mean()) > 260


def test_closed_from_another_thread(source: TwinSource) -> None:
    source.shot()
    source.set(exposure_s=9.0, gain=1.0)
    threading.Timer(0.1, source.close).start()
    # Had it waited for its nine seconds, there would be a frame.
    with pytest.raises(CameraError, match="closed"):
        source.shot()
    source.close()
    with pytest.raises(CameraError, match="not open"):
        source.shot()


def test_settings_beyond_the_limits(source: TwinSource) -> None:
    for exposure_s, gain in ((0.0, 1.0), (11.0, 1.0), (float("nan"), 1.0), (0.01, 0.1)):
        with pytest.raises(OptionError, match="beyond this camera"):
            source.set(exposure_s=exposure_s, gain=gain)


@pytest.mark.parametrize("text", ["", "twins", "folder", "folder:", "raspberry:x", "auto:1"])
def test_texts_that_name_no_source(text: str) -> None:
    with pytest.raises(OptionError, match="accepted are auto, raspberry"):
        open_source(text)


def test_listing_the_sources_loads_no_torch() -> None:
    # The server of a page does that, and is to start in a moment.
    code = (
        "import sys; from nolens.capture import available_sources as found; "
        "print([each.id for each in found()], 'torch' in sys.modules)"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout == "['raspberry', 'twin:live', 'folder', 'micromanager', 'genicam'] False\n"


def test_a_camera_that_does_not_exist() -> None:
    with pytest.raises(NolensError, match="Did you mean the preset 'small'"):
        open_source("twin:smal")
