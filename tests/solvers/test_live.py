"""Live: the newest frame, bounded waiting, and a count of all that was not shown."""

import threading

import pytest
import torch
from test_stream import SENSOR, SUPPORT, camera, error, scene

from nolens.solvers import Frame, Live, Problem, Stream


def stream() -> Stream:
    psf, blur = camera()
    return Stream(Problem.build(psf, blur(scene(0)), support=SUPPORT, tau=1e-5))


def test_slow_solver_drops_all_but_the_newest():
    _, blur = camera()
    frames = [blur(scene(step)) for step in range(12)]
    shown: list[Frame] = []
    begun, go_on = threading.Event(), threading.Event()

    def show(frame: Frame) -> None:
        shown.append(frame)
        begun.set()
        assert go_on.wait(30)

    with Live(stream(), show) as live:
        live.offer(frames[0])
        assert begun.wait(30)
        for each in frames[1:]:
            live.offer(each)
        assert live.dropped == 10
        go_on.set()
    assert len(shown) == 2
    assert error(shown[1].scene, scene(11)) < error(shown[1].scene, scene(5))


def test_every_frame_is_shown_dropped_or_refused():
    _, blur = camera()
    shown: list[Frame] = []
    with Live(stream(), shown.append) as live:
        for step in range(200):
            live.offer(torch.zeros(1, *SENSOR) if step % 7 == 3 else blur(scene(step)))
    assert len(shown) + live.dropped + live.refused == 200
    assert shown


def test_failure_of_the_viewer_is_raised_at_the_end():
    _, blur = camera()

    def show(_: Frame) -> None:
        raise ZeroDivisionError("no window")

    with pytest.raises(ZeroDivisionError, match="no window"), Live(stream(), show) as live:
        live.offer(blur(scene(0)))
