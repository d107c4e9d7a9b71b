"""Estimates of the memory that a simulation needs, and refusals."""

import math
import shutil
import tempfile
from dataclasses import dataclass, field
from pathlib import Path
from types import SimpleNamespace

import psutil
import pytest
import torch

from nolens.camera import FieldPsf, Measurement
from nolens.errors import OptionError
from nolens.files import read_camera
from nolens.jobs.run import announce_memory, check_solver_memory, mapped_where_needed
from nolens.machine import BYTES_OF_PROGRAM, check_memory
from nolens.optics import PointSource, surface_bytes
from nolens.solvers import Reconstructor, Stop
from nolens.twin import (
    Light,
    Plane,
    Twin,
    colours_of,
    irradiate_bytes,
    polychromatic_psf_bytes,
    preview_model,
    relief_points,
    simulation_bytes,
)

CPU = torch.device("cpu")


@dataclass
class Listener:
    notes: list[str] = field(default_factory=list)

    def note(self, text: str) -> None:
        self.notes.append(text)


@pytest.mark.parametrize(
    ("needed", "notes"),
    [(0, []), (9e8, []), (2.26e9, ["this takes about 2.3 GB of memory"])],
)
def test_gigabytes_are_told(needed: float, notes: list[str]) -> None:
    listener = Listener()
    announce_memory(needed, listener)  # type: ignore[arg-type]
    assert listener.notes == notes


def test_more_than_the_machine_has(monkeypatch: pytest.MonkeyPatch) -> None:
    """A part of it may be in a file, of a folder on a disk that has room."""
    monkeypatch.setattr(psutil, "virtual_memory", lambda: SimpleNamespace(total=4e9))
    monkeypatch.setattr(shutil, "disk_usage", lambda _: SimpleNamespace(free=2e9))
    mounts = [SimpleNamespace(mountpoint="/", fstype="ext4")]
    monkeypatch.setattr(psutil, "disk_partitions", lambda **_: mounts)
    assert not check_memory(3.9e9, CPU, "less needs less", 1e9)
    assert check_memory(5.9e9, CPU, "less needs less", 2e9)
    with pytest.raises(OptionError, match=r"4\.1 GB of memory, and the machine has 4\.0 GB: less"):
        check_memory(4.1e9, CPU, "less needs less")
    with pytest.raises(OptionError, match=r"even with 2\.0 GB of it in a file: less"):
        check_memory(6.1e9, CPU, "less needs less", 2e9)
    with pytest.raises(OptionError, match=r"has 2\.0 GB on a disk\. Name another by TMPDIR; less"):
        check_memory(6.1e9, CPU, "less needs less", 2.2e9)
    mounts.append(SimpleNamespace(mountpoint=tempfile.gettempdir(), fstype="tmpfs"))
    with pytest.raises(OptionError, match=r"has 0\.0 GB on a disk"):
        check_memory(5.9e9, CPU, "less needs less", 2e9)


@pytest.mark.skipif(not Path("/proc/self/maps").exists(), reason="asks Linux for its memory")
def test_psfs_in_files_where_memory_would_not_do(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    """The same picture, with the terms' memory that of files, of which nothing is left."""
    generator = torch.Generator().manual_seed(0)
    psfs = torch.rand((9, 1, 60, 80), generator=generator) ** 8
    places = torch.cartesian_prod(torch.tensor([-20.0, 0, 20]), torch.tensor([-30.0, 0, 30]))
    data = torch.rand((1, 60, 80), generator=generator)
    measured = Measurement(data, torch.ones_like(data, dtype=torch.bool), ("grey",), None, "test")
    resident = Reconstructor(
        psfs[0], field_psf=FieldPsf(psfs, places), tau=1e-4, stop=Stop(4, 0.0, 0.0, True)
    )
    needed = BYTES_OF_PROGRAM + resident.working_bytes(1, (60, 80)) - 1e5
    monkeypatch.setattr(psutil, "virtual_memory", lambda: SimpleNamespace(total=needed))
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    monkeypatch.setattr(psutil, "disk_partitions", lambda **_: [])
    listener = Listener()
    with pytest.raises(OptionError, match="less needs less"):
        check_solver_memory(resident, measured, "less needs less")
    mapped = mapped_where_needed(resident, measured, "less needs less", listener.note)
    assert "temporary file" in listener.notes[0] and str(tmp_path) in listener.notes[0]

    def in_files(*addresses: int) -> bool:
        """Whether memory at all of these is that of a file in the folder."""
        lines = [each.split() for each in Path("/proc/self/maps").read_text().splitlines()]
        spans = [line[0].split("-") for line in lines if str(tmp_path) in line[-2]]
        return all(
            any(int(low, 16) <= each < int(high, 16) for low, high in spans) for each in addresses
        )

    results = []
    for solver in (resident, mapped):
        problem = solver.problem(measured)
        terms = [each.stored for each in problem.forward.terms]
        total = sum(each.nbytes for each in terms)
        assert total == pytest.approx(mapped.mapped_bytes(1, (60, 80)), rel=0.05)
        assert in_files(*(each.data_ptr() for each in terms)) == (solver is mapped)
        results.append(solver.solve(problem).scene)
    torch.testing.assert_close(*results, rtol=0, atol=1e-6 * float(results[0].max()))
    assert not [*tmp_path.iterdir()]
    del problem, terms
    assert str(tmp_path) not in Path("/proc/self/maps").read_text()


def test_memory_of_a_pattern() -> None:
    """All of the pattern, and its largest window with what the relief's slopes reach."""
    twin = preview_model(read_camera("paper"), fresnel=False)
    near, far = (PointSource((0.0, 0.3), distance) for distance in (10e3, math.inf))

    def needed(source: PointSource, cells: tuple[int, int]) -> float:
        return polychromatic_psf_bytes(twin, source, cells, 2, at_least=2, shortest=450.0)

    kept = 4 * 6080 * 8112
    assert kept + 8 * 2800**2 < needed(far, (1520, 2028)) < 1.6 * (kept + 14 * 3072**2)
    # Near lights need smaller windows.
    assert kept < needed(near, (1520, 2028)) < needed(far, (1520, 2028))
    assert needed(far, (76, 101)) < needed(far, (1520, 2028)) / 30
    assert needed(far, (10**12, 10**12)) > 10**24


def test_memory_of_a_scene() -> None:
    """More planes need more, PSFs of nearer field points less; the relief is computed before."""
    twin = preview_model(read_camera("small"), fresnel=False)
    colours = colours_of(twin, Light("white-led"), 1)
    plane = Plane(torch.zeros(3, 4, 4), 40.0, 300e3)
    one = irradiate_bytes(twin, (plane,), 1, colours)
    assert one < irradiate_bytes(twin, (plane, plane), 1, colours)
    assert irradiate_bytes(twin, (plane,), 9, colours) < irradiate_bytes(twin, (plane,), 3, colours)
    assert (
        simulation_bytes(1e9, one)
        == simulation_bytes(1e9, 0)
        < BYTES_OF_PROGRAM + surface_bytes(1e9)
    )
    assert simulation_bytes(10, 1e9) == 1e9 + 40


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
