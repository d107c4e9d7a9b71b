"""PSFs at several field points, and the forward model with them, against the simulated camera."""

import math
from dataclasses import replace

import torch
from torch import Tensor

from nolens.calibrate.capture_plan import CapturePlan
from nolens.camera import FieldPsf, LoadedCamera, preset
from nolens.experiments.between_angles import errors_between
from nolens.experiments.virtual_experiment import VirtualExperiment
from nolens.optics import PointSource
from nolens.quantities import Angle
from nolens.solvers import Reconstructor
from nolens.twin import Light, Plane, Twin, irradiate, render_planes


def test_the_model_of_nine_psfs_measures_what_the_camera_does():
    """Green light without noise, of a scene that one PSF misses by 0.3 % of the contrast."""
    twin = Twin.of(LoadedCamera.of(preset("small"))).reading(48, 64)
    experiment = VirtualExperiment(twin, Light("535nm"))
    picture = torch.rand(3, 12, 16, generator=torch.Generator().manual_seed(1)) ** 3
    field, views = render_planes(twin, (Plane(picture, 40, 80e3),))
    light = irradiate(
        twin, field, views, field_points=5, light=experiment.light, wavelengths=1
    ).light
    measured = (light[0::2, 1::2] + light[1::2, 0::2])[None] / 2
    response = (field.solid_angle() * field.vignetting()).float()
    truth = (views[0].radiance * response)[1:2]
    psfs = experiment.field_psf(field.support, 3, 80e3)
    psfs = FieldPsf(psfs.values[:, 1:2], psfs.places)

    solver = Reconstructor(psfs.on_axis, field.support, tau=0.0)

    def missed(varied: Reconstructor) -> float:
        built = varied.problem(measured)
        image = built.forward(truth)
        image *= (image * built.data).sum() / image.square().sum()
        contrast = built.data - built.data.mean()
        return float((built.data - image).norm() / contrast.norm())

    several = replace(solver, field_psf=psfs)
    assert missed(several) < 1.8e-3
    assert missed(replace(several, basis_error=0.0)) < 1e-3
    assert missed(solver) > 3e-3


class _KnownPsfs(VirtualExperiment):
    """Its PSFs change with the square of the row that their chief rays fall on."""

    def row(self, source: PointSource) -> float:
        return self.twin.shift_um(source)[0] / self.twin.pixel_um

    def psf(self, source: PointSource, *_: object, **__: object) -> Tensor:
        return 1 + torch.tensor([[[1.0, -1.0]]]) * (1000 + self.row(source) ** 2)


def test_error_between_the_angles_of_a_plan() -> None:
    """In the middle of a step s, where lines miss (s/2)² of a parabola, splines miss less."""
    loaded = LoadedCamera.of(preset("small"))
    experiment = _KnownPsfs(Twin.of(loaded).reading(48, 64), Light("535nm"))
    angle = Angle.of(30, "deg")
    plans = [CapturePlan.of_scene(loaded.camera, (angle, angle), count) for count in (9, 25)]
    edge = experiment.row(PointSource((-math.tan(math.radians(16)), 0.0)))
    nine, many = errors_between(experiment, plans, lambda _: None)
    lines = [(edge / step) ** 2 / (1000 + (edge / step) ** 2) for step in (2, 4)]
    assert 0.15 * lines[0] < nine < 0.2 * lines[0] and 0.03 * lines[1] < many < 0.07 * lines[1]
