"""Moving scenes before a rolling shutter: every line sees the scene while it is exposed."""

from dataclasses import replace

import pytest
import torch

import nolens as nl
from nolens.camera import LoadedCamera, Shutter, preset
from nolens.experiments.virtual_experiment import VirtualExperiment, render_motion
from nolens.twin import Plane, PlaneView, render_planes


def test_lines_exposed_during_one_frame_measure_that_frame() -> None:
    small = preset("small")
    sensor = small.sensor.model_copy(update={"rolling": "out", "line_time_us": 10.0})
    camera = LoadedCamera.of(small.model_copy(update={"sensor": sensor}))
    experiment = VirtualExperiment.of(camera, field_points=1)
    generator = torch.Generator().manual_seed(0)
    plane = Plane(torch.rand((3, 9, 12), generator=generator), 20.0, 3e5)
    field, (view,) = render_planes(experiment.twin, (plane,))
    scenes = torch.stack([view.radiance, view.radiance.flip(-1)])
    exposure = {"exposure_s": 2e-4, "luminance_cd_m2": 2e5}
    moving = experiment.measure_motion(experiment.field_model(field, 3e5), scenes, **exposure)
    shutter = Shutter.of(sensor, 2e-4)
    parts = shutter.fractions(shutter.frames(2))
    for scene, part in zip(scenes, parts, strict=True):
        still, again = (
            experiment.measure_views(field, (PlaneView(scene, 3e5),), seed=seed, **exposure)
            for seed in (1, 2)
        )
        whole = part == 1
        assert int(whole.sum()) > 80
        counts = [each.frame.counts[0, whole] for each in (moving, still, again)]
        noise = float((counts[2] - counts[1]).std())
        assert float((counts[0] - counts[1]).std()) == pytest.approx(noise, rel=0.03)
        assert float(counts[0].std()) > 5 * noise
    assert moving.truth is scenes
    pictures = [plane.radiance, plane.radiance.flip(-1)]
    shot = nl.simulate(
        pictures, nl.Camera(camera), angle="20deg", exposure="0.2ms", field_points=1, seed=3
    )
    field, scenes = render_motion(experiment.twin, [replace(plane, radiance=p) for p in pictures])
    model = experiment.field_model(field, 3e5)
    again = experiment.measure_motion(model, scenes, exposure_s=2e-4, seed=3)
    assert torch.equal(shot.frame.counts, again.frame.counts)
    assert torch.equal(shot.truth, scenes) and shot.frame.exposure_s == 2e-4
    assert again.brightest_electrons == pytest.approx(0.9 * sensor.clip_electrons)
