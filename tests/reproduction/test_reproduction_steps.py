"""Steps whose results are kept: what is done again, what is taken, what an interruption leaves."""

from pathlib import Path
from typing import Any

import pytest
import torch
from watching import Watcher

from nolens.errors import DataError
from nolens.progress import ProgressCallback, within
from nolens.reproduction.steps import Step, StepResult, carry_out


class Work:
    """Steps that count how often they are done."""

    def __init__(self) -> None:
        self.done: list[str] = []

    def step(
        self, name: str, parameters: dict[str, Any], *, fails: BaseException | None = None
    ) -> Step:
        def run(progress: ProgressCallback) -> StepResult:
            self.done.append(name)
            progress(0.5)
            if fails is not None:
                raise fails
            values = torch.rand(3, 5, 7, generator=torch.Generator().manual_seed(len(name)))
            return StepResult({"third": 1 / 3, "none": None}, {"values": values}, {"part": 0.5})

        return Step(name, f"step {name}", parameters, 10.0, run)


def test_a_result_is_kept_to_the_bit_and_not_done_again(tmp_path: Path) -> None:
    work, watcher = Work(), Watcher()
    steps = [work.step("one", {"seed": 0}), work.step("three", {"seed": 0})]
    first = carry_out(steps, tmp_path, watcher)
    again = carry_out(steps, tmp_path, Watcher())
    assert work.done == ["one", "three"]
    expected = torch.rand(3, 5, 7, generator=torch.Generator().manual_seed(len("three")))
    for found in (first, again):
        assert found["three"].figures == {"third": 1 / 3, "none": None}
        assert torch.equal(found["three"].arrays["values"], expected)
        assert found["three"].seconds["part"] == 0.5
    assert watcher.fractions == sorted(watcher.fractions)
    assert watcher.fractions[0] == 0 and max(watcher.fractions) == 0.75


def test_time_left_goes_by_the_work_that_is_done(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """None is known of the first step; a step of three times the work takes three times as long."""
    now = 0.0
    monkeypatch.setattr("nolens.progress.time.perf_counter", lambda: now)

    def step(name: str, work: float) -> Step:
        def run(progress: ProgressCallback) -> StepResult:
            nonlocal now
            now += 60 * work
            return StepResult()

        return Step(name, name, {}, work, run)

    watcher = Watcher()
    carry_out([step("one", 2.0), step("two", 1.0), step("three", 6.0)], tmp_path, watcher)
    assert watcher.notes == [
        "one (1 of 3)",
        "two (2 of 3; about 7 min left)",
        "three (3 of 3; about 6 min left)",
    ]


def test_what_follows_from_other_parameters_is_done_again(tmp_path: Path) -> None:
    work = Work()
    carry_out([work.step("one", {"seed": 0}), work.step("two", {"seed": 0})], tmp_path, Watcher())
    carry_out([work.step("one", {"seed": 1}), work.step("two", {"seed": 0})], tmp_path, Watcher())
    assert work.done == ["one", "two", "one"]


@pytest.mark.parametrize(
    ("file", "old", "new"),
    [
        ("figures.json", None, b"II*"),
        ("figures.json", None, b"[" * 3000),
        ("figures.json", b'"third"', b'"fourth"'),
        ("figures.json", b"{", b'{"more": 1,'),
        ("figures.json", b'"figures": {', b'"figures": [], "more": {'),
        ("timing.json", None, b"II*"),
        ("timing.json", b"0.5", b'"a"'),
        ("values.tif", None, b"II*"),
        ("values.tif", b"\x3f", b"\x3e"),
    ],
)
def test_a_damaged_result_is_done_again(
    tmp_path: Path, file: str, old: bytes | None, new: bytes
) -> None:
    work = Work()
    carry_out([work.step("one", {})], tmp_path, Watcher())
    path = tmp_path / "one" / file
    content = path.read_bytes()
    assert old is None or old in content
    path.write_bytes(new if old is None else content.replace(old, new, 1))
    found = carry_out([work.step("one", {})], tmp_path, Watcher())
    assert work.done == ["one", "one"]
    assert found["one"].figures["third"] == 1 / 3


def test_an_interruption_loses_the_running_step_alone(tmp_path: Path) -> None:
    work = Work()
    with pytest.raises(KeyboardInterrupt):
        carry_out(
            [work.step("one", {}), work.step("two", {}, fails=KeyboardInterrupt())],
            tmp_path, Watcher(),
        )  # fmt: skip
    assert sorted(each.name for each in tmp_path.iterdir()) == ["one"]
    watcher = Watcher()
    found = carry_out([work.step("one", {}), work.step("two", {})], tmp_path, watcher)
    assert work.done == ["one", "two", "two"]
    assert set(found) == {"one", "two"}
    assert any("1 of 2 parts" in note for note in watcher.notes)


def test_what_a_camera_cannot_give_is_said_and_the_rest_goes_on(tmp_path: Path) -> None:
    work, watcher = Work(), Watcher()
    failing = work.step("one", {}, fails=DataError("no light reaches the sensor"))
    found = carry_out([failing, work.step("two", {})], tmp_path, watcher)
    assert found["one"].refused == "no light reaches the sensor"
    assert found["two"].refused is None
    assert "no light reaches the sensor" in watcher.warnings[0]
    assert carry_out([failing], tmp_path, watcher)["one"].refused == "no light reaches the sensor"


def test_a_bug_in_a_step_is_not_taken_for_a_limit_of_the_camera(tmp_path: Path) -> None:
    with pytest.raises(ZeroDivisionError):
        carry_out([Work().step("one", {}, fails=ZeroDivisionError())], tmp_path, Watcher())


def test_parts_of_a_step_follow_each_other() -> None:
    told: list[float] = []
    for start, length in ((0.0, 0.5), (0.5, 0.5)):
        part = within(told.append, start, length)
        part(0.5)
        part(1.0)
    assert told == [0.25, 0.5, 0.75, 1.0]


def test_the_key_knows_name_parameters_and_code() -> None:
    work = Work()
    keys = {
        work.step(name, {"value": value}).key for name in ("one", "two") for value in (0.1, 0.2)
    }
    assert len(keys) == 4
    assert work.step("one", {"value": 0.1}).key in keys
