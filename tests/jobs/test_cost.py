"""What a simulation is foretold to need."""

import math
from dataclasses import dataclass, field
from types import SimpleNamespace

import psutil
import pytest
import torch

from nolens.camera import camera_from_mapping, opened, preset
from nolens.errors import OptionError
from nolens.files import read_camera
from nolens.jobs.cost import Cost, announce, check_memory, colours_of, cost_of, pattern_size
from nolens.optics import PointSource
from nolens.quantities import Length
from nolens.twin import Light, Twin
from nolens.twin.preview import preview_model, relief_points

CPU = torch.device("cpu")


@dataclass
class Listener:
    notes: list[str] = field(default_factory=list)

    def note(self, text: str) -> None:
        self.notes.append(text)


@pytest.mark.parametrize(
    ("cost", "words"),
    [
        (Cost(5e8, 3), None),
        (Cost(2.26e9, 3), "about 2.3 GB of memory and 3 s on two cores"),
        (Cost(5e8, 25), "about 0.5 GB of memory and 25 s on two cores"),
        (Cost(5e8, 600), "about 0.5 GB of memory and 10 min on two cores"),
        (Cost(5e8, 7200), "about 0.5 GB of memory and 2.0 h on two cores"),
    ],
)
def test_what_is_long_or_large_is_told(cost: Cost, words: str | None) -> None:
    listener = Listener()
    announce(cost, CPU, listener)  # type: ignore[arg-type]
    assert listener.notes == ([] if words is None else [f"this takes {words}"])


def test_more_than_the_machine_has(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(psutil, "virtual_memory", lambda: SimpleNamespace(total=4e9))
    check_memory(Cost(3.9e9, 1), CPU, "less needs less")
    with pytest.raises(OptionError, match=r"4\.1 GB of memory, and the machine has 4\.0 GB: less"):
        check_memory(Cost(4.1e9, 1), CPU, "less needs less")


def test_samples_of_a_pattern() -> None:
    """All of the pattern, and around each window at least what the relief's slopes reach."""
    twin = preview_model(read_camera("paper"), fresnel=False)
    near, far = (PointSource((0.0, 0.3), distance) for distance in (10e3, math.inf))
    size = pattern_size(twin, far, (1520, 2028), 2, at_least=2, shortest=450.0)
    assert size.kept == 6080 * 8112 < size.intensity < 1.6 * size.kept
    assert size.largest < 3072**2 * 1.6
    # Near lights need smaller windows, and so more margin.
    assert (
        pattern_size(twin, near, (1520, 2028), 2, at_least=2, shortest=450.0).intensity
        > size.intensity
    )
    small = pattern_size(twin, far, (76, 101), 2, at_least=2, shortest=450.0)
    assert small.intensity < size.intensity / 30
    assert (
        pattern_size(twin, far, (10**12, 10**12), 2, at_least=2, shortest=450.0).intensity > 10**24
    )


def test_many_small_windows_take_long() -> None:
    """A sensor of metres sees a near light under so many directions that each needs a window."""
    camera = camera_from_mapping(
        preset("paper").model_dump()
        | {"mask": {"surface": 0, "relief": {"kind": "flat"}}},
        "camera.toml",
    )  # fmt: skip
    large = camera.model_copy(
        update={"sensor": camera.sensor.model_copy(update={"pitch": Length("1", "mm")})}
    )
    seconds = []
    for each in (camera, large):
        twin = preview_model(opened(each), fresnel=False)
        near = PointSource(distance_um=3e5)
        size = pattern_size(twin, near, (1520, 2028), 2, at_least=1, shortest=450.0)
        seconds.append(cost_of(size, 9, points=0, held=0).seconds)
    assert seconds[1] > 3 * seconds[0] and seconds[1] > 20


def test_outline_is_as_steep_as_the_relief() -> None:
    opened = read_camera("small")
    twin, whole = preview_model(opened, fresnel=True), Twin.of(opened, fresnel=True)
    assert twin.camera == whole.camera and twin.fresnel
    assert 0.7 < twin.mask.relief.steepest / whole.mask.relief.steepest <= 1
    points = whole.mask.relief.height_um.numel()
    assert points < relief_points(opened) < 1.3 * points


def test_wavelengths_of_all_channels() -> None:
    twin = preview_model(read_camera("small"), fresnel=False)
    assert [len(each) for each in colours_of(twin, Light("white-led"), 3)] == [3, 3, 3]
    assert colours_of(twin, Light("535nm"), 3) == [((535.0, 1.0),)] * 3
