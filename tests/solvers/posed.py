"""Small random problems, posed to the program and to the reference alike."""

from dataclasses import dataclass, field, replace
from functools import cache

import numpy as np
import torch

from nolens.operators import PixelRectangle
from nolens.solvers import Prior, Problem
from reference import Array, Reference, direct_sum


@dataclass(frozen=True)
class Case:
    """What a random problem is like.

    `view` fills the scene with light from everywhere, so that a uniform scene explains most of
    the data; without it the scene is a few points seen through a PSF of a few spots.
    """

    sensor: tuple[int, int] = (6, 8)
    psf: tuple[int, int] = (6, 8)
    support: PixelRectangle | None = None
    channels: int = 1
    psf_channels: int | None = None
    saturated: float = 0.0
    prior: str = "tv"
    tau: float = 1e-2
    view: bool = False
    seed: int = 1


@dataclass(frozen=True)
class Posed:
    case: Case
    psf: Array
    data: Array
    valid: Array
    problem: Problem = field(repr=False)

    def reference(self, channel: int) -> Reference:
        return Reference(
            self.psf[channel % self.psf.shape[0]],
            self.data[channel],
            self.valid[channel],
            self.problem.forward.geometry,
            self.case.tau,
            self.case.prior,
        )

    def pose(self, psf_factor: object = 1, data_factor: object = 1, **changed: object) -> Problem:
        """The same problem with PSF and data times a factor, or with other arrays."""
        psf = torch.from_numpy((self.psf * np.asarray(psf_factor)).astype(np.float32))
        data = torch.from_numpy((self.data * np.asarray(data_factor)).astype(np.float32))
        given: dict[str, object] = {
            "psf": psf,
            "data": data,
            "valid": torch.from_numpy(self.valid),
            "support": self.case.support,
            "tau": self.case.tau,
            "prior": self.case.prior,
            **changed,
        }
        return Problem.build(**given)  # type: ignore[arg-type]


@cache
def _drawn(case: Case) -> tuple[Array, Array, Array]:
    """PSF, measurement and mask of a case, whatever its prior and τ: the direct sum takes long."""
    rng = np.random.default_rng(case.seed)
    number = case.psf_channels or case.channels
    psf = rng.uniform(0, 1, (number, *case.psf))
    if not case.view:
        psf **= 12  # a few bright spots
    if case.support is None:
        origin = (-(case.psf[0] // 2), -(case.psf[1] // 2))
        size = (case.sensor[0] + case.psf[0] - 1, case.sensor[1] + case.psf[1] - 1)
    else:
        origin = (case.support.top, case.support.left)
        size = (case.support.height, case.support.width)
    scene = (
        rng.uniform(0.4, 1, (case.channels, *size))
        if case.view
        else np.zeros((case.channels, *size))
    )
    if not case.view:
        for each in scene:
            each[1:3, 1:4] = 1
            each[tuple(rng.integers(0, size))] = 2
    data = np.stack(
        [direct_sum(scene[k], origin, psf[k % number], case.sensor) for k in range(case.channels)]
    )
    data += 0.01 * data.max() * rng.standard_normal(data.shape)
    valid = rng.random(data.shape) >= case.saturated
    # What float32 holds is the problem, for the program and for the reference.
    return psf.astype(np.float32).astype(float), data.astype(np.float32).astype(float), valid


def pose(case: Case) -> Posed:
    """Draw PSF, scene and mask; measure by the direct sum, with noise of a part in a hundred."""
    alike = replace(case, prior=Case.prior, tau=Case.tau)
    psf, data, valid = (each.copy() for each in _drawn(alike))
    problem = Problem.build(
        torch.from_numpy(psf).float(),
        torch.from_numpy(data).float(),
        valid=torch.from_numpy(valid),
        support=case.support,
        tau=case.tau,
        prior=Prior(case.prior),
    )
    return Posed(case, psf, data, valid, problem)


def matrix(posed: Posed, channel: int) -> Array:
    """Forward model of a channel by the direct sum, valid pixels by scene cells, in unit norms."""
    forward, reference = posed.problem.forward, posed.reference(channel)
    psf = posed.psf[channel % posed.psf.shape[0]]
    height, width = forward.geometry.scene[2:]
    columns = []
    for cell in range(height * width):
        v = np.zeros(height * width)
        v[cell] = 1
        image = direct_sum(
            v.reshape(height, width), forward.geometry.origin, psf, posed.case.sensor
        )
        columns.append(image[posed.valid[channel]])
    data = np.where(posed.valid[channel], posed.data[channel], 0)
    norm = float(np.linalg.norm(data)) / reference.scale
    return np.stack(columns, axis=1) / norm


def unit_data(posed: Posed, channel: int) -> Array:
    """Valid pixels of a channel, in unit norm."""
    data = posed.data[channel][posed.valid[channel]]
    unit: Array = data / np.linalg.norm(data)
    return unit
