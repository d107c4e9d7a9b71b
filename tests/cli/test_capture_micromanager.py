"""Cameras of Micro-Manager, with its own demonstration camera."""

import json
import sys

import numpy as np
import pytest
from running import check_refused, run

from nolens.capture import available_sources, open_source
from nolens.errors import CameraError
from nolens.files import read_frame

SMALL = "OnCameraCCDXSize=48,OnCameraCCDYSize=32,Mode=Noise"
DEMO = f"micromanager:DemoCamera:DCam,{SMALL}"


@pytest.fixture
def demo():
    source = open_source(DEMO)
    source.open()
    yield source
    source.close()


def test_settings_reach_the_device(demo):
    """Exposure, gain and all bits; the light grows with the exposure."""
    limits = demo.limits
    assert limits.gain == (-5, 8) and limits.exposure_s[1] == 10
    means = []
    for exposure_s in (0.001, 0.004):
        demo.set(exposure_s=exposure_s, gain=2)
        shot = demo.shot()
        assert (shot.exposure_s, shot.gain) == (exposure_s, 2)
        assert shot.frame.size == (32, 48) and shot.frame.white == 65535
        means.append(float(shot.frame.counts.mean()))
    assert means[1] > means[0]
    assert not shot.frame.black_stated and shot.frame.exposure_s == 0.004


def test_a_burst_is_counted_and_no_frame_is_lost(demo):
    demo.set(exposure_s=0.001, gain=1)
    shots = list(demo.burst(40))
    assert [shot.details["frame_number"] for shot in shots] == list(range(40))
    assert len({shot.frame.counts.numpy().tobytes() for shot in shots}) == 40


def test_frames_that_did_not_fit_are_counted(demo, monkeypatch):
    """Nobody takes the frames until the device has stopped, as its buffer is full."""
    source = open_source("micromanager:DemoCamera:DCam,FastImage=1")
    source.open()
    core = source._core
    core.setCircularBufferMemoryFootprint(1)
    monkeypatch.setattr(source, "_make_room", lambda frames: None)
    source.set(exposure_s=1e-3, gain=1)
    shots = source.burst(60)
    taken = [next(shots)]
    while core.isSequenceRunning():
        pass
    with pytest.raises(
        CameraError, match=r"\d+ of 60 frames of .* were lost, as its buffer was full"
    ):
        taken.extend(shots)
    assert 1 < len(taken) < 60
    source.close()


def test_capture_to_disk(tmp_path):
    asked = ("--source", DEMO, "--exposure", "2ms", "--mosaic", "RGGB", "--frames", 3)
    done = run("capture", "-o", tmp_path / "a.tif", *asked)
    assert done.code == 0, done.err
    frames = [read_frame(tmp_path / f"a-000{number}.tif") for number in (1, 2, 3)]
    assert len({frame.counts.numpy().tobytes() for frame in frames}) == 3
    assert (frames[0].mosaic, frames[0].exposure_s) == ("RGGB", 0.002)
    assert not frames[0].black_stated
    record = json.loads((tmp_path / "a-0003.json").read_text())
    assert record["result"]["details"] == {"frame_number": 2}


def test_configuration_of_micro_manager(tmp_path):
    """Two cameras in one: the one that is named is taken, as it is configured."""
    file = tmp_path / "two.cfg"
    lines = ["Property,Core,Initialize,0"]
    lines += [f"Device,{name},DemoCamera,DCam" for name in ("Left", "Right")]
    lines += ["Property,Core,Initialize,1", "Property,Right,PixelType,16bit"]
    lines += ["Property,Right,BitDepth,12", "Property,Right,OnCameraCCDXSize,64"]
    file.write_text("\n".join(lines) + "\n")
    source = open_source(f"micromanager:{file}:Right")
    source.open()
    source.set(exposure_s=1e-3, gain=1)
    frame = source.shot().frame
    assert (frame.white, frame.size[1]) == (4095, 64)
    source.close()
    with pytest.raises(
        CameraError, match=r"more than one camera in .*: Left, Right\. Name the one, such"
    ):
        open_source(f"micromanager:{file}").open()


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("micromanager", ["more than one device adapter", "DemoCamera", "micromanager:"]),
        ("micromanager:Nope", ["no device adapter 'Nope'", "DemoCamera"]),
        ("micromanager:DemoCamera:DCan", ["no camera of DemoCamera 'DCan'", "mean DCam?"]),
        ("micromanager:DemoCamera,Mod=Noise", ["Mod=Noise", "did you mean Mode?"]),
        ("micromanager:DemoCamera,Mode=Blue", ["Mode=Blue", "accepted are Artificial Waves"]),
        ("micromanager:DemoCamera,Gain=99", ["Gain=99", "accepted are -5 to 8"]),
        ("micromanager:DemoCamera,Mode", ["'Mode' sets nothing", "PROPERTY=VALUE"]),
        ("micromanager:none.cfg", ["there is no file none.cfg"]),
        (f"{DEMO},PixelType=32bit", ["uint32", "PixelType=16bit"]),
    ],
)
def test_refused(text, words, tmp_path):
    done = run("capture", "--source", text, "-o", tmp_path / "a.tif", "--exposure", "1ms")
    check_refused(done, *words)
    assert not any(tmp_path.iterdir())


def test_without_adapters_and_without_the_extra(monkeypatch, tmp_path):
    monkeypatch.setenv("MICROMANAGER_PATH", str(tmp_path))
    with pytest.raises(CameraError, match=r"no device adapter .*MICROMANAGER_PATH to its folder"):
        open_source("micromanager:DemoCamera").open()
    monkeypatch.setitem(sys.modules, "pymmcore", None)
    with pytest.raises(CameraError, match=r"pip install 'nolens\[micromanager\]'"):
        open_source("micromanager:DemoCamera").open()
    facts = {fact.id: fact for fact in available_sources()}
    assert "pip install 'nolens[micromanager]'" in facts["micromanager"].why
    assert np.all(
        [fact.asks for name, fact in facts.items() if name in ("micromanager", "genicam")]
    )
