"""GenICam cameras: the simulated one of the package genicam, and a stand-in with what it lacks."""

import signal
import sys
from pathlib import Path
from types import ModuleType, SimpleNamespace

import genicam
import numpy as np
import pytest
from running import check_refused, run

from nolens.capture import open_source
from nolens.errors import CameraError, OptionError
from nolens.files import read_frame

PRODUCER = Path(genicam.__file__).with_name("viky.cti")
SMALL = "Width=100,Height=100,BouncingBallSize=20"


@pytest.mark.skipif(not PRODUCER.is_file(), reason="genicam without its simulated producer")
def test_simulated_producer(tmp_path, monkeypatch):
    """Three cameras: a part of a name chooses one; its frames are counted, and differ."""
    monkeypatch.setenv("GENICAM_GENTL64_PATH", str(PRODUCER.parent))
    asked = ("--frames", 3, "-o", tmp_path / "a.tif")
    refused = run("capture", "--source", "genicam", *asked)
    check_refused(refused, "more than one GenICam camera", "VikyTL_DEV_red", "'genicam:Viky 0")
    refused = run("capture", "--source", f"genicam:green,{SMALL}", *asked, "--exposure", "1ms")
    check_refused(refused, "has no exposure time that can be set", "leave out --exposure")
    done = run("capture", "--source", f"genicam:{PRODUCER}:green,{SMALL}", *asked)
    assert done.code == 0, done.err
    frames = [read_frame(tmp_path / f"a-000{number}.tif") for number in (1, 2, 3)]
    assert all(frame.size == (100, 100) and frame.channels == ("grey",) for frame in frames)
    assert len({frame.counts.numpy().tobytes() for frame in frames}) == 3
    source = open_source(f"genicam:red,{SMALL}")
    interrupt = signal.getsignal(signal.SIGINT)
    source.open()
    assert signal.getsignal(signal.SIGINT) is interrupt
    numbers = [shot.details["frame_number"] for shot in source.burst(5)]
    assert numbers == list(range(numbers[0], numbers[0] + 5))
    source.close()
    colour = open_source(f"genicam:blue,{SMALL},PixelFormat=RGBa8")
    colour.open()
    assert colour.shot().frame.channels == ("R", "G", "B")
    colour.close()
    for text, message in [
        ("red,Widht=100", "Widht=100: .* no such feature"),
        ("red,Width=5", "Width=5 is not taken by .*Min = 100"),
        ("red,PixelFormat=Mono12", "accepted are RGBa8, Mono8"),
    ]:
        with pytest.raises(OptionError, match=message):
            open_source(f"genicam:{text}").open()


class Node(SimpleNamespace):
    """A feature of the stand-in: a value, and what harvesters has of it."""


COUNTS = np.random.default_rng(5).integers(0, 4096, (32, 48), dtype=np.uint16)


class StandIn:
    """What is used of `harvesters.core.Harvester` and `ImageAcquirer`, as harvesters 1.4 has it.

    The camera has exposure, gain in dB, a black level, a Bayer pattern, triggers, and frames that
    can be lost.
    """

    def __init__(self):
        self.numbers = iter(range(10, 10_000))
        self.log = []
        self.busy, self.waits = False, False
        self.device_info_list = [SimpleNamespace(model="Eye", serial_number="42", id_="eye-42")]
        self.node_map = SimpleNamespace(
            ExposureTime=Node(value=1e4, min=20.0, max=1e6),
            Gain=Node(value=6.0, min=0.0, max=24.0, unit="dB"),
            BlackLevel=Node(value=64.0, unit=""),
            ExposureAuto=Node(value="Continuous"),
            PixelFormat=Node(
                value="Mono8", symbolics=("Mono8", "Mono12", "BayerGB8", "BayerGB12p")
            ),
            TriggerMode=Node(value="On", symbolics=("Off", "On")),
            TriggerSource=Node(value="Line0", symbolics=("Line0", "Line1", "Software")),
            TriggerSoftware=Node(execute=lambda: self.log.append("trigger")),
            PayloadSize=Node(value=48 * 32 * 2),
        )
        self.remote_device = SimpleNamespace(node_map=self.node_map)
        self.num_buffers = 3

    def add_file(self, *_, **__): ...
    def update(self): ...
    def reset(self): ...
    def destroy(self): ...

    def create(self, number):
        if self.busy:
            raise type("ResourceInUseException", (Exception,), {})("opened elsewhere")
        return self

    def start(self):
        self.log.append("start")

    def stop(self):
        self.log.append("stop")

    def try_fetch(self, *, timeout):
        if self.waits:
            return None
        component = SimpleNamespace(
            data_format=self.node_map.PixelFormat.value, width=48, height=32,
            num_components_per_pixel=1.0, data=COUNTS.ravel(),
        )  # fmt: skip
        return SimpleNamespace(
            payload=SimpleNamespace(components=[component]),
            frame_id=next(self.numbers),
            queue=lambda: self.log.append("queue"),
        )


@pytest.fixture
def camera(monkeypatch, tmp_path):
    made = StandIn()
    core = ModuleType("harvesters.core")
    core.Harvester = lambda: made
    monkeypatch.setitem(sys.modules, "harvesters.core", core)
    monkeypatch.setenv("GENICAM_GENTL64_PATH", str(tmp_path))
    (tmp_path / "eye.cti").touch()
    return made


def opened(text):
    warnings = []
    source = open_source(text, warn=warnings.append)
    source.open()
    return source, warnings


def test_what_the_device_says(camera):
    """Its mosaic, bits, black level, limits; nothing automatic; gain is a factor, not dB."""
    source, _ = opened("genicam:42")
    nodes = camera.node_map
    assert (nodes.PixelFormat.value, nodes.ExposureAuto.value) == ("BayerGB12p", "Off")
    assert nodes.TriggerMode.value == "Off"
    limits = source.limits
    assert limits.exposure_s == pytest.approx((2e-5, 1)) and limits.gain[0] == 1
    source.set(exposure_s=0.02, gain=10)
    assert (nodes.ExposureTime.value, nodes.Gain.value) == (2e4, 20)
    shot = source.shot()
    assert np.array_equal(shot.frame.counts[0], COUNTS)
    assert (shot.frame.mosaic, shot.frame.white, shot.frame.black) == ("GBRG", 4095, (64,))
    assert shot.frame.black_stated and (shot.exposure_s, shot.gain) == (0.02, 10)
    assert camera.log == ["start", "queue", "stop"]
    nodes.BlackLevel = Node(value=2.0, unit="%")
    assert source.shot().frame.black[0] == pytest.approx(0.02 * 4095)
    source.close()
    with pytest.raises(CameraError, match="is not open"):
        source.shot()


def test_lost_frames_are_counted(camera):
    source, warnings = opened("genicam")
    camera.numbers = iter([7, 8, 11, 12, 14, 15])
    numbers = [shot.details["frame_number"] for shot in source.burst(6)]
    assert numbers == [7, 8, 11, 12, 14, 15]
    assert len(warnings) == 1 and warnings[0].startswith(
        "3 frames of GenICam Eye 42 eye-42 were lost"
    )
    assert "between the 6 that were taken" in warnings[0]
    assert camera.num_buffers == 6 and camera.log.count("queue") == 6


def test_triggers(camera, monkeypatch):
    source, _ = opened("genicam:Eye,TriggerSource=Software")
    list(source.burst(3))
    assert camera.log == ["start", *(["trigger", "queue"] * 3), "stop"]
    source.close()
    source, _ = opened("genicam:Eye,TriggerSource=Line1")
    assert camera.node_map.TriggerMode.value == "On"
    monkeypatch.setattr("nolens.capture.genicam._TRIGGER_S", 0.0)
    monkeypatch.setattr("nolens.capture.genicam.PATIENCE_S", 0.0)
    camera.waits = True
    with pytest.raises(
        CameraError, match=r"no frame .*after 0 frames: its trigger \(Line1\) did not"
    ):
        source.shot()
    assert camera.log[-1] == "stop"
    source.close()


def test_refused(camera, tmp_path, monkeypatch):
    def refusal(text):
        done = run("capture", "--source", text, "-o", tmp_path / "a.tif", "--exposure", "1ms")
        assert done.code == 2
        return done.err

    camera.busy = True
    assert "in use by another program (opened elsewhere): close that one" in refusal("genicam")
    camera.busy = False
    assert "no GenICam camera '43'; there are Eye 42 eye-42" in refusal("genicam:43")
    assert "accepted are Line0, Line1, Software" not in refusal("genicam:43")
    camera.device_info_list = []
    assert "there is no GenICam camera: see that it is connected" in refusal("genicam")
    assert "there is no GenTL producer none.cti" in refusal("genicam:none.cti")
    monkeypatch.delenv("GENICAM_GENTL64_PATH")
    assert "set GENICAM_GENTL64_PATH to the folder of its .cti" in refusal("genicam")
    monkeypatch.setitem(sys.modules, "harvesters.core", None)
    assert "pip install 'nolens[genicam]'" in refusal("genicam")
