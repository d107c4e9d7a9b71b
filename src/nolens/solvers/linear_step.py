"""The linear step that has the measurement in it: preconditioned conjugate gradients."""

import math
from dataclasses import dataclass

import torch
import torch.nn.functional as nnf
from torch import Tensor

from nolens.kernels import irfft2, irfft2_window_, rfft2_window
from nolens.operators import slow_cosines
from nolens.solvers.admm_state import Penalties
from nolens.solvers.problem import Problem

_INNER = 3
"""Steps of conjugate gradients."""
_TINY = 1e-300
_PIXELS = 20_000
"""That are in float64 at a time."""


class LinearStep:
    r"""Solves for one channel's scene, each time from the scene before,

    .. math:: (A^*A + μ_2 Ψ^*Ψ + μ_3)\, v = A^*b + t, \qquad A = VCM,

    with V what counts of an image (`Problem.counted`). The matrix is not diagonal in the Fourier
    domain. A few steps of conjugate gradients are preconditioned by its circulant mean
    :math:`ρ\,|H|^2 / \overline{|H|^2} + μ_2|D|^2 + μ_3`, where ρ is the fraction of the energy of
    white noise that A keeps, and an exact solution for the slowest cosines, deflated (A-DEF2 of
    `tang2009`): the eigenvalue of the scene's mean is ten thousand times that of the others.

    The forward model may vary over the field; :math:`|H|^2` is then the mean of its terms'.

    Parameters
    ----------
    problem
        Of one channel, in normalised units.
    scene
        Where to start from, (1, height, width).
    varied
        Whether μ₂ is ever above 0.
    """

    def __init__(self, problem: Problem, scene: Tensor, *, varied: bool) -> None:
        self._problem = problem
        self._first = first_in_frame(problem)
        self._varied = varied
        self.v = scene
        self.residual = problem.counted(problem.data)
        self._circulant = _Circulant(problem)
        self._cosines = _Cosines(problem, varied=varied)

    def measure(self, problem: Problem) -> None:
        """Go on with another measurement."""
        if not torch.equal(problem.valid, self._problem.valid):
            self._cosines.measure(problem)
        self._problem = problem

    def renew_residual(self) -> None:
        """Compute the residual anew, of which steps lose a little each."""
        self.residual = self._problem.residual(self.v)

    def solve(self, target: Tensor, penalties: Penalties) -> None:
        """Go nearer to the scene with Kv = A*b + target, K = A*A + μ₂Ψ*Ψ + μ₃.

        Parameters
        ----------
        target
            Of the scene's shape.
        penalties
            μ₁, which does not matter, μ₂ and μ₃.
        """
        cosines, forward = self._cosines, self._problem.forward
        circulant = self._circulant.inverse(penalties)
        matrix = cosines.matrix(penalties)
        amounts = matrix.solve(
            cosines.along_image(self.residual)
            + cosines.along(target - self.prior_part(penalties, self.v))
        )
        self.v = self.v + cosines.sum(amounts)
        self.residual -= cosines.image(amounts)
        direction = image = before = product = None
        for _ in range(_INNER):
            left = forward.adjoint(self.residual) + target - self.prior_part(penalties, self.v)
            ahead = circulant(left)
            light = self._image(ahead)
            missed = cosines.along(left - self.prior_part(penalties, ahead)) - cosines.along_image(
                light
            )
            amounts = matrix.solve(missed)
            ahead += cosines.sum(amounts)
            light += cosines.image(amounts)
            slope = dot(left, ahead)
            if direction is None or image is None or before is None or product is None:
                direction, image = ahead, light
            else:
                # Polak-Ribière: the preconditioner need not be exact.
                turn = float(((slope - dot(before, ahead)) / product.clamp_min(_TINY)).clamp_min(0))
                direction, image = ahead.add_(direction, alpha=turn), light.add_(image, alpha=turn)
            before, product = left, slope
            bend = dot(image, image) + dot(direction, self.prior_part(penalties, direction))
            length = float(dot(left, direction) / bend.clamp_min(_TINY))
            self.v.add_(direction, alpha=length)
            self.residual.sub_(image, alpha=length)

    def inverse(self, target: Tensor, penalties: Penalties) -> Tensor:
        """K⁻¹ target, about as near as `solve` comes in one call; v and residual stay.

        Parameters
        ----------
        target, penalties
            As `solve` takes them.
        """
        v, residual = self.v, self.residual
        self.v, self.residual = torch.zeros_like(v), torch.zeros_like(residual)
        self.solve(target, penalties)
        inverse, self.v, self.residual = self.v, v, residual
        return inverse

    def noise_gain(self, penalties: Penalties, bands: int) -> Tensor:
        r"""Root mean density, in octaves below 1/2 cycle per pixel, of noise of 1 in v.

        By the circulant mean |G|² of A*A: the root of the mean of
        :math:`|G|^2 / (|G|^2 + μ_2|D|^2 + μ_3)^2`. The last octave has the corners, too, the first
        all below.

        Parameters
        ----------
        penalties
            As `solve` takes them.
        bands
            Number of octaves.
        """
        return self._circulant.noise_gain(penalties, bands)

    def prior_part(self, penalties: Penalties, scene: Tensor) -> Tensor:
        """(μ₂Ψ*Ψ + μ₃) v: four times each pixel, less its neighbours; zero around the scene."""
        _, second, third = penalties
        if not self._varied:
            return third * scene
        part = (4 * second + third) * scene
        for axis, around in zip((-2, -1), self._first, strict=True):
            length = scene.shape[axis]
            inner = (axis, 0, length - 1), (axis, 1, length - 1)
            for one, other in (inner, inner[::-1]):
                part.narrow(*one).sub_(scene.narrow(*other), alpha=second)
            if around == 0:  # The scene is the whole padded shape, and goes around.
                part.narrow(axis, 0, 1).sub_(scene.narrow(axis, length - 1, 1), alpha=second)
                part.narrow(axis, length - 1, 1).sub_(scene.narrow(axis, 0, 1), alpha=second)
        return part

    def _image(self, scene: Tensor) -> Tensor:
        """A v: what counts of a scene's image."""
        return self._problem.counted(self._problem.forward(scene))


def first_in_frame(problem: Problem) -> tuple[int, int]:
    """Where a scene begins in its frame: 1, beside a zero, or 0 where it is the padded shape."""
    (_, _, *sides), padded = problem.forward.geometry.scene, problem.forward.geometry.padded
    rows, columns = (min(side + 1, most) - side for side, most in zip(sides, padded, strict=True))
    return rows, columns


class _Circulant:
    """The circulant mean of the matrix, and its inverse on the scene's pixels."""

    def __init__(self, problem: Problem) -> None:
        self._geometry = problem.forward.geometry
        height, width = self._geometry.padded
        rows, columns = (
            2 - 2 * torch.cos(2 * math.pi * torch.arange(count) / side)
            for count, side in ((height, height), (width // 2 + 1, width))
        )
        self._rows, self._columns = rows.to(problem.data)[:, None], columns.to(problem.data)
        power = problem.forward.power
        energy = irfft2(power.to(torch.complex64), self._geometry.padded)[0, 0, 0]
        self._data = power.mul_(_fraction_on_sensor(problem) / energy)
        self._penalties: Penalties | None = None
        self._inverse = self._data

    def inverse(self, penalties: Penalties) -> "_Circulant":
        """With these penalties."""
        if penalties != self._penalties:
            _, second, third = self._penalties = penalties
            steps = self._rows + self._columns
            self._inverse = (second * steps + self._data).add_(third).reciprocal_()
        return self

    def noise_gain(self, penalties: Penalties, bands: int) -> Tensor:
        """See `LinearStep.noise_gain`."""
        inverse = self.inverse(penalties)._inverse
        density = (self._data.clamp_min(0) * inverse.square()).flatten()
        height, width = self._geometry.padded
        down = torch.fft.fftfreq(height, device=density.device)[:, None]
        frequency = torch.hypot(down, torch.fft.rfftfreq(width, device=density.device))
        octave = torch.floor(torch.log2(frequency.clamp_min(1e-9)) + 1 + bands).clamp(0, bands - 1)
        number = octave.long().flatten()
        sums = density.new_zeros(bands).index_add_(0, number, density)
        return (sums / torch.bincount(number, minlength=bands).clamp_min(1)).sqrt()

    def __call__(self, scene: Tensor) -> Tensor:
        geometry = self._geometry
        spectrum = rfft2_window(scene, geometry.scene[:2], geometry.padded)
        return irfft2_window_(spectrum.mul_(self._inverse), geometry.scene, geometry.padded)


def _fraction_on_sensor(problem: Problem) -> Tensor:
    """ρ = E‖An‖² / E‖n‖² for white noise n without a mean."""
    generator = torch.Generator().manual_seed(0)
    signs = torch.randint(0, 2, problem.scene_shape, generator=generator) * 2.0 - 1
    noise = (signs - signs.mean()).to(problem.data)
    image = problem.counted(problem.forward(noise))
    return (dot(image, image) / dot(noise, noise)).to(noise)


class _Cosines:
    """Slow cosines of the scene, products along both sides, and what A makes of them."""

    def __init__(self, problem: Problem, *, varied: bool) -> None:
        height, width = problem.scene_shape[1:]
        self._rows, self._columns = (
            slow_cosines(each).to(problem.data) for each in (height, width)
        )
        self.measure(problem)
        self._gram_varied = torch.zeros_like(self._gram)
        if varied:
            around = first_in_frame(problem)
            rows, columns = (
                (gram(each), gram(steps_along(each, beyond)))
                for each, beyond in zip((self._rows, self._columns), around, strict=True)
            )
            self._gram_varied = torch.kron(rows[1], columns[0]) + torch.kron(rows[0], columns[1])

    def measure(self, problem: Problem) -> None:
        """See them by what counts of a measurement."""
        modes = (row[:, None] * column for row in self._rows for column in self._columns)
        self._images = torch.cat([problem.counted(problem.forward(each[None])) for each in modes])
        self._gram = gram(self._images.flatten(1))

    def matrix(self, penalties: Penalties) -> "_Coarse":
        """The matrix in the space of the cosines."""
        _, second, third = penalties
        unit = torch.eye(len(self._gram)).to(self._gram)
        return _Coarse(
            torch.linalg.cholesky(self._gram + second * self._gram_varied + third * unit)
        )

    def along(self, scene: Tensor) -> Tensor:
        """Inner products with the cosines."""
        return (self._rows @ scene @ self._columns.T).flatten()

    def along_image(self, image: Tensor) -> Tensor:
        """Inner products of what counts of an image with what A makes of the cosines."""
        return self._images.flatten(1) @ image.flatten()

    def sum(self, amounts: Tensor) -> Tensor:
        """The scene of so much of each."""
        return self._rows.T @ amounts.view(len(self._rows), -1) @ self._columns

    def image(self, amounts: Tensor) -> Tensor:
        """What the sensor sees of that."""
        image: Tensor = (amounts @ self._images.flatten(1)).view_as(self._images[:1])
        return image


@dataclass(frozen=True)
class _Coarse:
    """The Cholesky factor of a small matrix."""

    factor: Tensor

    def solve(self, amounts: Tensor) -> Tensor:
        """Amounts of the cosines whose products with the matrix these are."""
        solution: Tensor = torch.cholesky_solve(amounts.double()[:, None], self.factor)
        return solution[:, 0].to(amounts)


def steps_along(waves: Tensor, beyond: int) -> Tensor:
    """Differences along waves, to so many zeros beyond them, and around."""
    padded = nnf.pad(waves, (0, beyond))
    return padded - padded.roll(1, -1)


def gram(rows: Tensor, weights: Tensor | None = None) -> Tensor:
    """Inner products of all pairs of rows; float64, as rows that are nearly alike make it singular.

    Parameters
    ----------
    rows
        (count, pixels).
    weights
        Of the pixels; None for 1.
    """
    total = rows.new_zeros(len(rows), len(rows), dtype=torch.float64)
    for first in range(0, rows.shape[1], _PIXELS):
        part = rows[:, first : first + _PIXELS].double()
        total += (part if weights is None else part * weights[first : first + _PIXELS]) @ part.T
    return total


def dot(x: Tensor, y: Tensor) -> Tensor:
    """Inner product; float64."""
    return torch.dot(x.reshape(-1), y.reshape(-1)).double()
