"""PSFs at several field points, and the forward model with them, against the simulated camera."""

import pytest
import torch

from nolens.camera import FieldPsf, LoadedCamera, preset
from nolens.experiments.virtual_experiment import VirtualExperiment
from nolens.solvers import Problem, problem
from nolens.twin import Light, Plane, Twin, irradiate, render_planes


def test_the_model_of_nine_psfs_measures_what_the_camera_does(monkeypatch: pytest.MonkeyPatch):
    """Green light without noise, of a scene whose edges one PSF misses by 0.6 % of the contrast."""
    twin = Twin.of(LoadedCamera.of(preset("small"))).reading(48, 64)
    experiment = VirtualExperiment(twin, Light("535nm"))
    picture = torch.rand(3, 12, 16, generator=torch.Generator().manual_seed(1)) ** 3
    field, views = render_planes(twin, (Plane(picture, 40, 80e3),))
    light = irradiate(
        twin, field, views, field_points=3, light=experiment.light, wavelengths=1
    ).light
    measured = (light[0::2, 1::2] + light[1::2, 0::2])[None] / 2
    response = (field.solid_angle() * field.vignetting()).float()
    truth = (views[0].radiance * response)[1:2]
    psfs = experiment.field_psf(field.support, 3, 80e3)
    psfs = FieldPsf(psfs.values[:, 1:2], psfs.places)

    def missed(field_psf: FieldPsf | None) -> float:
        built = Problem.build(
            psfs.on_axis, measured, support=field.support, tau=0, field_psf=field_psf
        )
        image = built.forward(truth)
        image *= (image * built.data).sum() / image.square().sum()
        contrast = built.data - built.data.mean()
        return float((built.data - image).norm() / contrast.norm())

    assert missed(psfs) < 2.5e-3
    monkeypatch.setattr(problem, "_BASIS_ERROR", 0.0)
    assert missed(psfs) < 1e-3
    assert missed(None) > 5e-3
