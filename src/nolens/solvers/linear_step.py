"""The linear step that has the measurement in it: preconditioned conjugate gradients."""

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass

import torch
import torch.nn.functional as nnf
from torch import Tensor

from nolens.kernels import irfft2, irfft2_window_, rfft2, rfft2_window
from nolens.operators import CroppedConvolution, slow_cosines, slow_waves
from nolens.solvers.admm_state import Penalties
from nolens.solvers.problem import Problem

_INNER = 3
"""Steps of conjugate gradients."""
_TINY = 1e-300
_PIXELS = 20_000
"""That are in float64 at a time."""


class LinearStep:
    r"""Solves for one channel's scene, each time from the scene before,

    .. math:: K v = A^*b + t, \qquad K = A^*A + P, \quad P = μ_2 Ψ^*Ψ + μ_3, \quad A = VCM,

    with V what counts of an image (`Problem.counted`). The matrix is not diagonal in the Fourier
    domain. A few steps of conjugate gradients are preconditioned by its circulant mean
    :math:`ρ\,|H|^2 / \overline{|H|^2} + μ_2|D|^2 + μ_3`, where ρ is the fraction of the energy of
    white noise that A keeps, and an exact solution for the slowest cosines, deflated (A-DEF2 of
    `tang2009`): the eigenvalue of the scene's mean is ten thousand times that of the others.

    The forward model may vary over the field; :math:`|H|^2` is then the mean of its terms'. Where
    one PSF stands for all and the scene is the whole padded shape, all but V is diagonal in the
    Fourier domain, and the steps are made there: two transforms for each in place of six.

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
        whole = type(problem.forward) is CroppedConvolution and problem.forward.support is None
        self._form: _Pixels = (_Spectrum if whole else _Pixels)(problem, varied=varied)
        self._circulant = _Circulant(problem)
        self._cosines = _Cosines(problem, self._form, varied=varied)
        self._vector = self._form.vector(scene)
        self._residual: Tensor | None = None

    @property
    def v(self) -> Tensor:
        """The scene, (1, height, width), which steps leave as it is; computed at every call."""
        return self._form.scene(self._vector)

    @v.setter
    def v(self, scene: Tensor) -> None:
        self._vector = self._form.vector(scene)
        self._residual = None

    @property
    def residual(self) -> Tensor:
        """What counts of b − Av; steps bring it up to date, and change its memory."""
        if self._residual is None:
            light = self._form.light(self._vector)
            self._residual = self._problem.counted(self._problem.data - light)
        return self._residual

    def measure(self, problem: Problem) -> None:
        """Go on with another measurement."""
        if not torch.equal(problem.valid, self._problem.valid):
            self._cosines.measure(problem)
        self._problem, self._residual = problem, None

    def renew_residual(self) -> None:
        """Have the residual computed anew, of which steps lose a little each."""
        self._residual = None

    def solve(self, target: Tensor, penalties: Penalties, steps: int = _INNER) -> None:
        """Go nearer to the scene with Kv = A*b + target.

        Parameters
        ----------
        target
            Of the scene's shape.
        penalties
            μ₁, which does not matter, μ₂ and μ₃.
        steps
            Of conjugate gradients.
        """
        form, cosines = self._form, self._cosines
        inverse, matrix = self._circulant.inverse(penalties), cosines.matrix(penalties)
        prior = form.prior(penalties)
        wanted, residual = form.vector(target), self.residual
        pulls, pull = cosines.pulls, None
        if pulls is None:
            asked = cosines.along_image(residual)
        else:
            pull = form.adjoint(residual)
            asked = cosines.along(pull)
        amounts = matrix.solve(
            asked + cosines.along(wanted) - cosines.along_prior(penalties, self._vector)
        )
        step = cosines.sum(amounts)
        self._vector = v = form.moved(self._vector, step)
        if pulls is None or pull is None:
            residual -= cosines.image(amounts)
        else:
            residual -= self._light(step)
            pull -= (amounts @ pulls).view_as(pull)
        direction = image = before = product = None
        for _ in range(steps):
            left = form.adjoint(residual) if pull is None else pull
            left, pull = left.add_(wanted).sub_(prior(v)), None
            ahead = form.filtered(left, inverse)
            missed = cosines.along(left) - cosines.along_prior(penalties, ahead)
            if pulls is None:
                light = self._light(ahead)
                amounts = matrix.solve(missed - cosines.along_image(light))
                ahead += cosines.sum(amounts)
                light += cosines.image(amounts)
            else:
                ahead += cosines.sum(matrix.solve(missed - pulls @ ahead.flatten()))
                light = self._light(ahead)
            slope = form.dot(left, ahead)
            if float(slope) <= 0:
                break  # Solved, as far as rounding goes.
            if direction is None or image is None or before is None:
                direction, image = ahead, light
            else:
                assert product is not None
                # Polak-Ribière: the preconditioner need not be exact.
                turned = (slope - form.dot(before, ahead)) / product.clamp_min(_TINY)
                turn = float(turned.clamp_min(0))
                direction, image = (
                    new.add_(old, alpha=turn) for new, old in ((ahead, direction), (light, image))
                )
            before, product = left, slope
            bend = dot(image, image) + form.dot(direction, prior(direction))
            length = float(form.dot(left, direction) / bend.clamp_min(_TINY))
            v.add_(direction, alpha=length)
            residual.sub_(image, alpha=length)

    def objective(self, penalties: Penalties) -> float:
        """½‖b − Av‖² + ½ vᵀPv; the scene with Kv = A*b has least.

        Parameters
        ----------
        penalties
            As `solve` takes them.
        """
        prior = self._form.dot(self._vector, self._form.prior(penalties)(self._vector))
        return float(dot(self.residual, self.residual) + prior) / 2

    def _light(self, vector: Tensor) -> Tensor:
        """What counts of a vector's light on the sensor."""
        return self._problem.counted(self._form.light(vector)).contiguous()

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


class _Pixels:
    """Scenes as vectors of their pixels."""

    def __init__(self, problem: Problem, *, varied: bool) -> None:
        self._forward = problem.forward
        self._geometry = problem.forward.geometry
        self._first = first_in_frame(problem)
        self._varied = varied

    def vector(self, scene: Tensor) -> Tensor:
        """That of a scene."""
        return scene

    def moved(self, vector: Tensor, step: Tensor) -> Tensor:
        """The vector of a `LinearStep` and a step of it; a scene's memory stays as it is."""
        return vector + step

    def scene(self, vector: Tensor) -> Tensor:
        """That of a vector."""
        return vector

    def waves(self, rows: Tensor, columns: Tensor) -> tuple[Tensor, Tensor]:
        """Factors of vectors, from rows and columns whose products are scenes."""
        return rows, columns

    def along(self, vector: Tensor, rows: Tensor, columns: Tensor) -> Tensor:
        """Inner products with the products of rows and columns that `waves` made."""
        return rows @ vector[0] @ columns.T

    def images(self, problem: Problem, light: Iterator[Tensor], count: int) -> "_Images":
        """Images of cosines, from their light on the sensor."""
        return _Images(problem, light, count)

    def dot(self, x: Tensor, y: Tensor) -> Tensor:
        """Inner product of the scenes; float64."""
        return dot(x, y)

    def light(self, vector: Tensor) -> Tensor:
        """CMv: a scene's light on the sensor."""
        return self._forward(vector)

    def adjoint(self, image: Tensor) -> Tensor:
        """M*C* of an image."""
        return self._forward.adjoint(image)

    def filtered(self, vector: Tensor, spectrum: Tensor) -> Tensor:
        """The scene's pixels of a scene times a real half spectrum."""
        geometry = self._geometry
        product = rfft2_window(vector, geometry.scene[:2], geometry.padded).mul_(spectrum)
        return irfft2_window_(product, geometry.scene, geometry.padded)

    def prior(self, penalties: Penalties) -> Callable[[Tensor], Tensor]:
        """V ↦ (μ₂Ψ*Ψ + μ₃) v: four times each pixel, less its neighbours; zero around the scene."""
        _, second, third = penalties
        if not self._varied:
            return lambda vector: third * vector

        def of(vector: Tensor) -> Tensor:
            part = (4 * second + third) * vector
            for axis, around in zip((-2, -1), self._first, strict=True):
                length = vector.shape[axis]
                inner = (axis, 0, length - 1), (axis, 1, length - 1)
                for one, other in (inner, inner[::-1]):
                    part.narrow(*one).sub_(vector.narrow(*other), alpha=second)
                if around == 0:  # The scene is the whole padded shape, and goes around.
                    part.narrow(axis, 0, 1).sub_(vector.narrow(axis, length - 1, 1), alpha=second)
                    part.narrow(axis, length - 1, 1).sub_(vector.narrow(axis, 0, 1), alpha=second)
            return part

        return of


class _Images:
    """What counts of the light of cosines on the sensor.

    Parameters
    ----------
    problem
        That says what counts.
    light
        Of one after the other, (1, height, width).
    count
        How many there are.

    Attributes
    ----------
    gram
        Inner products of all pairs; float64.
    pulls
        M*C* of each, (number, pixels), where the scene has fewer pixels than the sensor: the images
        are then not kept.
    """

    pulls: Tensor | None = None

    def __init__(self, problem: Problem, light: Iterator[Tensor], count: int) -> None:
        # In place, as together they are many times the measurement.
        images = problem.data.new_empty((count, *problem.data.shape[1:]))
        for image, each in zip(images, light, strict=True):
            image.copy_(problem.counted(each)[0])
        self.gram = gram(images.flatten(1))
        if math.prod(problem.scene_shape[1:]) < images[0].numel():
            adjoint = problem.forward.adjoint
            self.pulls = torch.stack([adjoint(each[None]).flatten() for each in images])
        else:
            self._images = images

    def along(self, image: Tensor) -> Tensor:
        """Inner products with what counts of an image."""
        return self._images.flatten(1) @ image.flatten()

    def sum(self, amounts: Tensor) -> Tensor:
        """So much of each, (1, height, width)."""
        total: Tensor = (amounts @ self._images.flatten(1)).view_as(self._images[:1])
        return total


class _WaveImages(_Images):
    """The same where the scene is the whole padded shape, as sums of products of `slow_waves`.

    Of where cosines end no light reaches the sensor, so each is such a sum, without an error.
    """

    def __init__(self, problem: Problem, light: Iterator[Tensor]) -> None:
        self._problem = problem
        geometry = problem.forward.geometry
        rows, columns = (
            slow_waves(side, period).to(problem.data.device)
            for side, period in zip(geometry.sensor[2:], geometry.padded, strict=True)
        )
        parts = torch.stack([rows @ each[0].double() @ columns.T for each in light])
        self.gram = torch.stack([self._products(parts, each, rows, columns) for each in parts])
        self._rows, self._columns, self._parts = (
            each.to(problem.data) for each in (rows, columns, parts)
        )

    def _products(self, parts: Tensor, part: Tensor, rows: Tensor, columns: Tensor) -> Tensor:
        """A row of the matrix of inner products."""
        image = self._problem.counted((rows.T @ part @ columns)[None])[0]
        products: Tensor = torch.tensordot(parts, rows @ image @ columns.T, dims=2)
        return products

    def along(self, image: Tensor) -> Tensor:
        """Inner products with what counts of an image."""
        waves = self._rows @ image[0] @ self._columns.T
        products: Tensor = torch.tensordot(self._parts, waves, dims=2)
        return products

    def sum(self, amounts: Tensor) -> Tensor:
        """So much of each, (1, height, width)."""
        waves = torch.tensordot(amounts, self._parts, dims=1)
        return self._problem.counted((self._rows.T @ waves @ self._columns)[None])


class _Spectrum(_Pixels):
    """Scenes that are the whole padded shape as vectors of their half spectra."""

    def __init__(self, problem: Problem, *, varied: bool) -> None:
        super().__init__(problem, varied=varied)
        height, width = self._geometry.padded
        self._steps = tuple(each.to(problem.data) for each in steps_power(height, width))

    def vector(self, scene: Tensor) -> Tensor:
        """That of a scene."""
        return rfft2(scene)

    def moved(self, vector: Tensor, step: Tensor) -> Tensor:
        """The same, in the vector's memory."""
        return vector.add_(step)

    def scene(self, vector: Tensor) -> Tensor:
        """That of a vector."""
        return irfft2(vector, self._geometry.padded)

    def waves(self, rows: Tensor, columns: Tensor) -> tuple[Tensor, Tensor]:
        """Factors of vectors, from rows and columns whose products are scenes."""
        return torch.fft.fft(rows), torch.fft.rfft(columns)

    def along(self, vector: Tensor, rows: Tensor, columns: Tensor) -> Tensor:
        """Inner products with the products of rows and columns that `waves` made."""
        height, width = self._geometry.padded
        # Frequencies but the first and the last stand for their negatives, too.
        weights = torch.full_like(columns.real[0], 2 / (height * width))
        weights[[0, -1]] /= 2
        return (rows.conj() @ vector[0] @ (weights * columns.conj()).T).real

    def images(self, problem: Problem, light: Iterator[Tensor], count: int) -> _Images:
        """Images of cosines, from their light on the sensor."""
        return _WaveImages(problem, light)

    def dot(self, x: Tensor, y: Tensor) -> Tensor:
        """Inner product of the scenes; float64."""
        ends = [
            dot(x[..., end].real, y[..., end].real) + dot(x[..., end].imag, y[..., end].imag)
            for end in (0, -1)
        ]
        both = dot(torch.view_as_real(x), torch.view_as_real(y))
        return (2 * both - ends[0] - ends[1]) / math.prod(self._geometry.padded)

    def light(self, vector: Tensor) -> Tensor:
        """CMv: a scene's light on the sensor."""
        geometry = self._geometry
        return irfft2_window_(vector * self._forward.transfer, geometry.sensor, geometry.padded)

    def adjoint(self, image: Tensor) -> Tensor:
        """M*C* of an image."""
        geometry = self._geometry
        spectrum = rfft2_window(image, geometry.sensor[:2], geometry.padded)
        return spectrum.mul_(self._forward.transfer.conj())

    def filtered(self, vector: Tensor, spectrum: Tensor) -> Tensor:
        """The scene's pixels of a scene times a real half spectrum."""
        return vector * spectrum

    def prior(self, penalties: Penalties) -> Callable[[Tensor], Tensor]:
        """V ↦ (μ₂Ψ*Ψ + μ₃) v."""
        _, second, third = penalties
        if not self._varied:
            return lambda vector: third * vector
        rows, columns = self._steps
        weights = (second * rows + third) + second * columns
        return lambda vector: vector * weights


def steps_power(height: int, width: int) -> tuple[Tensor, Tensor]:
    """|D|² of the half spectrum: a part of the rows, (height, 1), and one of the columns."""
    rows, columns = (
        2 - 2 * torch.cos(2 * math.pi * torch.arange(count) / side)
        for count, side in ((height, height), (width // 2 + 1, width))
    )
    return rows[:, None], columns


def first_in_frame(problem: Problem) -> tuple[int, int]:
    """Where a scene begins in its frame: 1, beside a zero, or 0 where it is the padded shape."""
    (_, _, *sides), padded = problem.forward.geometry.scene, problem.forward.geometry.padded
    rows, columns = (min(side + 1, most) - side for side, most in zip(sides, padded, strict=True))
    return rows, columns


class _Circulant:
    """The circulant mean of the matrix."""

    def __init__(self, problem: Problem) -> None:
        self._geometry = problem.forward.geometry
        self._steps = tuple(each.to(problem.data) for each in steps_power(*self._geometry.padded))
        power = problem.forward.power
        # Frequencies but the first and the last stand for their negatives, too.
        total = 2 * power.sum() - power[..., 0].sum() - power[..., -1].sum()
        energy = total / math.prod(self._geometry.padded)
        self._data = power.mul_(_fraction_on_sensor(problem) / energy)

    def inverse(self, penalties: Penalties) -> Tensor:
        """Half spectrum of its inverse with these penalties."""
        _, second, third = penalties
        rows, columns = self._steps
        return (second * (rows + columns) + self._data).add_(third).reciprocal_()

    def noise_gain(self, penalties: Penalties, bands: int) -> Tensor:
        """See `LinearStep.noise_gain`."""
        inverse = self.inverse(penalties)
        density = (self._data.clamp_min(0) * inverse.square()).flatten()
        height, width = self._geometry.padded
        down = torch.fft.fftfreq(height, device=density.device)[:, None]
        frequency = torch.hypot(down, torch.fft.rfftfreq(width, device=density.device))
        octave = torch.floor(torch.log2(frequency.clamp_min(1e-9)) + 1 + bands).clamp(0, bands - 1)
        number = octave.long().flatten()
        sums = density.new_zeros(bands).index_add_(0, number, density)
        return (sums / torch.bincount(number, minlength=bands).clamp_min(1)).sqrt()


def _fraction_on_sensor(problem: Problem) -> Tensor:
    """ρ = E‖An‖² / E‖n‖² for white noise n without a mean."""
    generator = torch.Generator().manual_seed(0)
    signs = torch.randint(0, 2, problem.scene_shape, generator=generator) * 2.0 - 1
    noise = (signs - signs.mean()).to(problem.data)
    image = problem.counted(problem.forward(noise))
    return (dot(image, image) / dot(noise, noise)).to(noise)


class _Cosines:
    """Slow cosines of the scene, products along both sides, and what A makes of them.

    Attributes
    ----------
    pulls
        A*A of each, (number, pixels of the scene), whose products take less time than those of
        images; None where the scene has more pixels than the sensor.
    """

    def __init__(self, problem: Problem, form: _Pixels, *, varied: bool) -> None:
        self._form, self._varied = form, varied
        rows, columns = (slow_cosines(each).to(problem.data) for each in problem.scene_shape[1:])
        self._rows, self._columns = rows, columns
        self._factors = form.waves(rows, columns)
        self.measure(problem)
        self._gram_varied = torch.zeros_like(self._gram)
        if varied:
            beyond = first_in_frame(problem)
            pairs = list(zip((rows, columns), beyond, strict=True))
            whole, steps = (
                [gram(each) for each, _ in pairs],
                [gram(steps_along(each, around)) for each, around in pairs],
            )
            self._gram_varied = torch.kron(steps[0], whole[1]) + torch.kron(whole[0], steps[1])
            bent = [torch.cat([each, bends_along(each, around)]) for each, around in pairs]
            self._with_bends = form.waves(bent[0], bent[1])

    def measure(self, problem: Problem) -> None:
        """See them by what counts of a measurement."""
        light = problem.forward.of_products(self._rows, self._columns)
        count = len(self._rows) * len(self._columns)
        self._images = self._form.images(problem, light, count)
        self._gram, self.pulls = self._images.gram, self._images.pulls

    def matrix(self, penalties: Penalties) -> "_Coarse":
        """The matrix in the space of the cosines."""
        _, second, third = penalties
        unit = torch.eye(len(self._gram)).to(self._gram)
        return _Coarse(
            torch.linalg.cholesky(self._gram + second * self._gram_varied + third * unit)
        )

    def along(self, vector: Tensor) -> Tensor:
        """Inner products with the cosines."""
        return self._form.along(vector, *self._factors).flatten()

    def along_prior(self, penalties: Penalties, vector: Tensor) -> Tensor:
        """Inner products of (μ₂Ψ*Ψ + μ₃) v with the cosines."""
        _, second, third = penalties
        if not self._varied:
            return third * self.along(vector)
        both, count = self._form.along(vector, *self._with_bends), len(self._rows)
        most = len(self._columns)
        bends = both[count:, :most] + both[:count, most:]
        return (third * both[:count, :most] + second * bends).flatten()

    def along_image(self, image: Tensor) -> Tensor:
        """Inner products of what counts of an image with what A makes of the cosines."""
        return self._images.along(image)

    def sum(self, amounts: Tensor) -> Tensor:
        """The vector of so much of each."""
        rows, columns = self._factors
        return rows.T @ (amounts.view(len(rows), -1).to(rows) @ columns)

    def image(self, amounts: Tensor) -> Tensor:
        """What the sensor sees of that."""
        return self._images.sum(amounts)


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


def bends_along(waves: Tensor, beyond: int) -> Tensor:
    """Second differences along waves, with so many zeros beyond them, and around."""
    padded = nnf.pad(waves, (0, beyond))
    bends = 2 * padded - padded.roll(1, -1) - padded.roll(-1, -1)
    return bends[..., : waves.shape[-1]]


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
