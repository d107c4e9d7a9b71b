"""Several scenes from one measurement: depths, bands or instants."""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace

import torch
from torch import Tensor

from nolens.errors import DataError
from nolens.kernels import irfft2, irfft2_window_, rfft2_window
from nolens.operators import CroppedConvolution, StackConvolution, StackDifference, slow_cosines
from nolens.solvers.data_terms import Gaussian, Poisson
from nolens.solvers.functionals import L1, Functional, GroupSparsity, NonNegative, OpponentL1
from nolens.solvers.held_out import (
    Weight,
    held_out_blocks,
    pixel_noise,
    pixels_of,
    prediction_errors,
    search_weight,
    weight_of_errors,
)
from nolens.solvers.linear_step import gram, steps_along
from nolens.solvers.result import Callback, Progress, Result
from nolens.solvers.split_admm import split_admm

_INNER = 3
"""Steps of conjugate gradients in each iteration."""
_FIRST_STEPS, _STEPS = 28, 12
"""Iterations with the first weight that is tried, and with each that follows."""
_BY_NOISE = {False: 0.6, True: 1.0}
_FROM = {False: 1.0, True: 2.0}
"""Weight where only the noise is known, and first weight that is tried, over the noise of a pixel;
of differences, and of the ℓ1 norm (decision 13)."""
_UNIT_SIDE = 1000
"""Pixels along a square sensor on which a weight of differences is the same in normalised units."""
_TINY = 1e-30
_STACK_BYTES = 150
"""Held in a run, per pixel of the padded shape of every slice and channel; 116 to 131 measured."""


@dataclass(frozen=True)
class StackPrior:
    r"""What a stack of scenes is assumed to be like.

    Parameters
    ----------
    across
        Weight of differences between neighbouring slices over those between neighbouring pixels;
        0 for none.
    isotropic
        The lengths of the differences at a pixel, in place of their sum.
    sparse
        ‖v‖₁ in place of differences: few bright points.
    colours
        Three channels are colours, whose edges are likelier at one place (`OpponentL1`).
    """

    across: float = 0.0
    isotropic: bool = False
    sparse: bool = False
    colours: bool = False

    def functional(self, shape: Sequence[int]) -> Functional:
        """R(v) of stacks of the shape (channels, slices, height, width), dark around them."""
        if self.sparse:
            return L1()
        slices, height, width = shape[-3:]
        differences = StackDifference((slices, height, width), self.across)
        if self.colours:
            return OpponentL1.of_scene(-5) @ differences
        return (GroupSparsity(-4) if self.isotropic else L1()) @ differences


@dataclass(frozen=True)
class StackProblem:
    r"""Minimise ½Σ w (b − Av)² + τ R(v) over stacks v ≥ 0, with A a `StackConvolution`.

    In normalised units: PSFs with their masks have a mean norm of 1, a channel of the data has a
    mean norm of 1, and w has a mean of 1. Make one with `StackProblem.build`.
    """

    forward: StackConvolution = field(repr=False)
    data: Tensor = field(repr=False)
    """(channels, rows, columns), zero where not valid."""
    valid: Tensor = field(repr=False)
    """bool, like `data`: pixels that take part in the fit."""
    weights: Tensor = field(repr=False)
    """Like `data`: inverse variances of the pixels' noise, zero where not valid."""
    prior: StackPrior
    scale: float
    """A scene in units of measurement over PSF, over one in normalised units."""
    norm: float
    """Mean norm of a channel of the measurement, which is 1 in normalised units."""
    noise: float
    """Standard deviation of a pixel's noise where w is 1; normalised."""
    counts: Poisson | None = field(default=None, repr=False)
    """In place of the squares (`counting`)."""

    @classmethod
    def build(
        cls,
        forward: StackConvolution,
        data: Tensor,
        *,
        valid: Tensor | None = None,
        variance: Tensor | None = None,
        prior: StackPrior = StackPrior(),
    ) -> "StackProblem":
        """Normalise a forward model and a measurement.

        Parameters
        ----------
        forward
            In any unit; its PSFs are scaled in place, as there may be no memory for others.
        data
            ``(channels, rows, columns)``, linear, background removed.
        valid
            Like `data`, bool: False where a pixel takes no part in the fit.
        variance
            > 0, of the noise of each pixel in the data's unit, broadcast to `data`. None for
            equal ones, measured by neighbouring pixels, which masks must then not tell apart.
        prior
            R.

        Raises
        ------
        DataError
            If shapes do not fit, or PSFs or data hold nothing but zeros.
        """
        if data.ndim != 3 or tuple(data.shape[-2:]) != forward.sensor:
            raise DataError(
                f"the measurement is {tuple(data.shape)}, and the forward model gives "
                f"{forward.sensor}: give (channels, rows, columns) of its size"
            )
        if forward.channels not in (1, len(data)):
            raise DataError(
                f"the PSFs have {forward.channels} channels and the measurement {len(data)}: give "
                "one PSF for all channels or one for each"
            )
        valid = torch.ones_like(data, dtype=torch.bool) if valid is None else valid.expand_as(data)
        data = torch.where(valid, data, 0)
        norm = float(torch.linalg.vector_norm(data.double())) / math.sqrt(len(data))
        psf_norm = math.sqrt(float(_energies(forward).mean()))
        if not (norm > 0 and psf_norm > 0):
            raise DataError("the PSFs or the measurement are zero everywhere; nothing to solve")
        inverse = torch.ones_like(data) if variance is None else 1 / variance.expand_as(data)
        weights = torch.where(valid, inverse, 0)
        mean = float(weights.sum() / valid.sum())
        forward.scale_(data.new_tensor(1 / psf_norm))
        problem = cls(
            forward,
            data / norm,
            valid,
            weights / mean,
            prior,
            norm / psf_norm,
            norm,
            1 / norm / mean**0.5,
        )
        return problem if variance is not None else replace(problem, noise=pixel_noise(problem))

    def counting(self, per_electron: float, read_noise: float) -> "StackProblem":
        r"""The same by Poisson's law of the electrons in place of the variance of each pixel.

        .. math:: σ^2 \sum (t - c \ln t) + τ R(v), \qquad t = Av + r^2, \quad c = \max(b + r^2, 0),

        with t and c in electrons: the read noise, a variance of r², is taken for Poisson's of as
        much light. σ is `noise`, so that τ weighs as much as beside the squares.

        Parameters
        ----------
        per_electron
            Of the measurement's unit, as the `variance` that the problem was built with has it.
        read_noise
            Standard deviation r, electrons.
        """
        unit = per_electron / self.norm
        more = read_noise**2 * unit
        counts = (self.data + more).clamp_min(0)
        weights = self.noise**2 / unit * self.valid
        return replace(self, counts=Poisson(counts, background=more, weights=weights))

    @property
    def scene_shape(self) -> tuple[int, int, int, int]:
        """(channels, slices, height, width)."""
        return (len(self.data), self.forward.slices, *self.forward.geometry.scene[2:])

    @property
    def channel_weights(self) -> Tensor:
        """Equal ones: channels have the same unit."""
        return torch.full((len(self.data),), 1 / len(self.data), dtype=torch.float64)

    @property
    def tau_unit(self) -> float:
        """Weight in normalised units of a weight of 1 as users give it (`Problem.weight`)."""
        if self.prior.sparse:
            return 1.0
        return math.sqrt(math.prod(self.forward.sensor)) / _UNIT_SIDE

    @property
    def weight_by_noise(self) -> float:
        """The weight where the noise alone tells it, in the unit of `Problem.weight`."""
        return _BY_NOISE[self.prior.sparse] * self.noise / self.tau_unit

    def residual(self, scene: Tensor) -> Tensor:
        """B − Av on the valid pixels, zero on others; normalised."""
        return torch.where(self.valid, self.data - self.forward(scene), 0)

    def functionals(self, tau: float) -> list[Functional]:
        """The objective's; `tau` as users give it."""
        fit = (self.counts or Gaussian(self.data, weights=self.weights)) @ self.forward
        prior = self.prior.functional(self.scene_shape)
        return [fit, *([tau * self.tau_unit * prior] if tau > 0 else []), NonNegative()]

    def choose_weight(self, progress: Callable[[float], bool | None] | None = None) -> Weight:
        """The weight with which left-out pixels are predicted best (decision 13).

        Parameters
        ----------
        progress
            Called with the fraction that is done; stops by returning True.
        """
        noise, unit = self.noise, self.tau_unit
        blocks = held_out_blocks(self.valid)
        if blocks is None:
            return Weight(self.weight_by_noise, noise)
        held = pixels_of(blocks, self.forward.sensor).to(self.data.device)
        fitted = replace(
            self,
            data=torch.where(held, 0, self.data),
            valid=self.valid & ~held,
            weights=torch.where(held, 0, self.weights),
            counts=None,
        )
        step = _Step(fitted)
        scene: Tensor | None = None

        def errors(tau: float, fraction: float) -> Tensor | None:
            nonlocal scene

            def watch(_: Progress) -> bool:
                return progress is not None and bool(progress(fraction))

            result = fitted._run(
                tau / unit, step, scene, _FIRST_STEPS if scene is None else _STEPS, 0.0, watch
            )
            scene = result.scene
            stopped = result.stop_reason == "callback"
            return None if stopped else prediction_errors(self, scene, held, blocks)

        tried, interrupted = search_weight(_FROM[self.prior.sparse] * noise, errors)
        if not tried:
            chosen = Weight(self.weight_by_noise, noise)
        else:
            chosen = weight_of_errors(self, tried, noise, held, blocks)
        return replace(chosen, interrupted=interrupted)

    def solve(
        self,
        tau: float,
        *,
        iterations: int = 200,
        tolerance: float = 1e-2,
        callback: Callback | None = None,
    ) -> Result:
        """The stack, in units of measurement over PSF, (channels, slices, height, width).

        Parameters
        ----------
        tau
            Weight of the prior, ≥ 0, in the unit of `Problem.weight`.
        iterations
            Limit, ≥ 1.
        tolerance
            Stops when all relative residuals are at most that (`split_admm`).
        callback
            Called at every convergence check; stops the run by returning True.

        Raises
        ------
        OptionError
            If a parameter lies outside its range.
        DivergenceError
            If an iterate is NaN or infinite.
        """

        def seen(progress: Progress) -> bool | None:
            assert callback is not None
            scene = progress.scene
            return callback(replace(progress, scene=lambda: scene() * self.scale))

        result = self._run(
            tau, _Step(self), None, iterations, tolerance, None if callback is None else seen
        )
        return replace(result, scene=result.scene * self.scale)

    def _run(
        self,
        tau: float,
        step: "_Step",
        start: Tensor | None,
        iterations: int,
        tolerance: float,
        callback: Callback | None,
    ) -> Result:
        return split_admm(
            *self.functionals(tau),
            start=self._uniform() if start is None else start,
            iterations=iterations,
            tolerance=tolerance,
            linear_step=step,
            callback=callback,
        )

    def _uniform(self) -> Tensor:
        """The uniform stack of each channel that fits best."""
        ones = self.data.new_ones(self.scene_shape)
        glow = self.forward(ones)
        weighed = glow * self.weights
        level = (weighed * self.data).sum((-2, -1)) / (weighed * glow).sum((-2, -1))
        return ones * level.clamp_min(0)[:, None, None, None]


def stack_bytes(slices: int, channels: int, padded: tuple[int, int]) -> float:
    """Most memory that `StackProblem.solve` holds, its operators' included.

    Parameters
    ----------
    slices, channels
        Of the stack.
    padded
        The padded shape (`Geometry.padded`).
    """
    return _STACK_BYTES * slices * channels * math.prod(padded)


class _Step:
    r"""The linear step of `split_admm` for a stack, by deflated conjugate gradients.

    Solves :math:`(A^*WA + μ_2 Ψ^*Ψ + μ_3)\, v = t` as `nolens.solvers.data_step` does for one
    scene, a few steps from the scene before: preconditioned by the circulant mean of the matrix,
    and exact among the slowest cosines of all slices (A-DEF2 of `tang2009`). Without those the
    edge of a scene, where the circulant mean errs, leaves eigenvalues of thousands.
    """

    def __init__(self, problem: StackProblem) -> None:
        self._counts = problem.counts is not None
        if self._counts:
            problem = replace(problem, weights=torch.ones_like(problem.data))
        self._forward, self._weights = problem.forward, problem.weights
        self._differences: StackDifference | None = None
        if not problem.prior.sparse:
            slices, height, width = problem.scene_shape[1:]
            self._differences = StackDifference((slices, height, width), problem.prior.across)
        self._circulant, self._cosines = _Circulant(problem), _Cosines(problem)
        self._penalties: tuple[float, float] | None = None

    def _go_on_with(self, penalties: tuple[float, float]) -> None:
        """Inverses with other penalties, which stay for several iterations."""
        if penalties != self._penalties:
            self._penalties = penalties
            self._precondition = self._circulant.inverse(*penalties)
            self._solve = self._cosines.inverse(*penalties)

    def __call__(self, v: Tensor, target: Tensor, penalties: Sequence[float]) -> Tensor:
        """Go nearer to the solution from v, with the penalties of the splits."""
        if self._counts:  # Av has a split of its own.
            target = target / penalties[0]
            penalties = [each / penalties[0] for each in penalties[1:]]
        second, third = penalties if len(penalties) == 2 else (0.0, *penalties)
        self._go_on_with((second, third))
        circulant, solve = self._precondition, self._solve
        forward, weights, cosines = self._forward, self._weights, self._cosines

        def prior_part(scene: Tensor) -> Tensor:
            part = third * scene
            if second and self._differences is not None:
                part += second * self._differences.adjoint(self._differences(scene))
            return part

        left = target - forward.adjoint(weights * forward(v)) - prior_part(v)
        amounts = solve(cosines.along(left))
        change, light = cosines.sum(amounts), cosines.image(amounts)
        v = v + change
        left = left - forward.adjoint(weights * light) - prior_part(change)
        direction = image = before = torch.zeros(())
        product = math.inf
        for _ in range(_INNER):
            ahead = circulant(left)
            light = forward(ahead)
            missed = cosines.along(left - prior_part(ahead)) - cosines.along_image(weights * light)
            amounts = solve(missed)
            ahead = ahead + cosines.sum(amounts)
            light = light + cosines.image(amounts)
            slope = float((left * ahead).sum())
            # Polak-Ribière: the preconditioner need not be exact.
            turn = max((slope - float((before * ahead).sum())) / max(product, _TINY), 0.0)
            direction, image = ahead + turn * direction, light + turn * image
            before, product = left, slope
            part = prior_part(direction)
            bend = float((weights * image.square()).sum() + (direction * part).sum())
            length = float((left * direction).sum()) / max(bend, _TINY)
            v = v + length * direction
            left = left - length * (forward.adjoint(weights * image) + part)
        return v


class _Circulant:
    r"""The circulant mean of the linear step's matrix, and its inverse on the scenes' pixels.

    With the transfer functions :math:`H_k`, masks of means :math:`u_k` and variances
    :math:`e_k`, and ρ the part of the energy of white noise that reaches the sensor, the data's
    part is :math:`ρ\,(\bar h h^T + \mathrm{diag}(e_k |H_k|^2))` with :math:`h_k = u_k H_k`, to
    which the penalties add :math:`d = μ_2 |D|^2 + μ_3`: a diagonal and a matrix of rank one, which
    the formula of Sherman and Morrison inverts at each frequency (`golub2013`, § 2.1.4).
    """

    def __init__(self, problem: StackProblem) -> None:
        forward = self._forward = problem.forward
        across = 0.0 if problem.prior.sparse else problem.prior.across
        height, width = forward.geometry.padded
        rows, columns = (
            2 - 2 * torch.cos(2 * math.pi * torch.arange(count) / side)
            for count, side in ((height, height), (width // 2 + 1, width))
        )
        # Between slices: the mean of the eigenvalues.
        self._steps = (rows[:, None] + columns).add_(2 * across**2).to(problem.data)
        self._mean, self._spread = torch.ones(forward.slices), torch.zeros(forward.slices)
        if forward.masks is not None:
            pixels = forward.masks.double().flatten(1)
            self._mean, self._spread = pixels.mean(1), pixels.var(1, correction=0)
        generator = torch.Generator().manual_seed(0)
        signs = torch.randint(0, 2, problem.scene_shape, generator=generator) * 2.0 - 1
        noise = (signs - signs.mean(dim=(-2, -1), keepdim=True)).to(problem.data)
        image = forward(noise).double().square() * problem.weights
        self._part = float(image.sum() / noise.double().square().sum() / _energies(forward).mean())

    def inverse(self, second: float, third: float) -> Callable[[Tensor], Tensor]:
        """With the penalties of differences and of the scene."""
        forward, part = self._forward, self._part
        geometry = forward.geometry
        means, spreads = self._mean.tolist(), self._spread.tolist()
        prior = second * self._steps + third
        total = torch.zeros_like(prior)
        inverses = []
        for operator, mean, spread in zip(forward.operators, means, spreads, strict=True):
            power = operator.power
            inverse = (power * (part * spread)).add_(prior).reciprocal_()
            total = total + part * mean**2 * power * inverse
            inverses.append(inverse)
        shared = part / (1 + total)

        def apply(stack: Tensor) -> Tensor:
            spectra = []
            along = torch.zeros(())
            terms = list(zip(forward.operators, means, inverses, strict=True))
            for number, (operator, mean, inverse) in enumerate(terms):
                scene = stack[..., number, :, :].contiguous()
                spectrum = rfft2_window(scene, geometry.scene[:2], geometry.padded).mul_(inverse)
                along = along + operator.transfer * spectrum * mean
                spectra.append(spectrum)
            along = along * shared
            out = torch.empty_like(stack)
            for number, ((operator, mean, inverse), spectrum) in enumerate(
                zip(terms, spectra, strict=True)
            ):
                spectrum -= operator.transfer.conj() * along * (mean * inverse)
                out[..., number, :, :] = irfft2_window_(spectrum, geometry.scene, geometry.padded)
            return out

        return apply


class _Cosines:
    """Slow cosines of every slice, what the sensor sees of them, and an exact solution in them."""

    def __init__(self, problem: StackProblem) -> None:
        forward, self._sensor = problem.forward, problem.forward.sensor
        channels, slices, height, width = problem.scene_shape
        self._rows, self._columns = (
            slow_cosines(each).to(problem.data) for each in (height, width)
        )
        modes = torch.einsum("iy,jx->ijyx", self._rows, self._columns).flatten(0, 1)
        images = [
            forward.image_of(number, modes[:, None].expand(-1, forward.channels, -1, -1))
            for number in range(slices)
        ]
        seen = torch.cat(images).transpose(0, 1).flatten(2)
        self._images = seen if len(seen) == channels else seen.expand(channels, -1, -1)
        self._gram = torch.stack(
            [
                gram(each, weights.flatten())
                for each, weights in zip(self._images, problem.weights, strict=True)
            ]
        )
        self._unit = torch.eye(len(seen[0]), dtype=torch.float64).to(self._gram)
        self._varied = torch.zeros_like(self._unit)
        if not problem.prior.sparse:
            rows, columns = (
                (torch.eye(len(each)).double(), steps @ steps.T)
                for each, steps in (
                    (waves, steps_along(waves.double().cpu(), 1))
                    for waves in (self._rows, self._columns)
                )
            )
            inside = torch.kron(rows[1], columns[0]) + torch.kron(rows[0], columns[1])
            every = torch.eye(slices, dtype=torch.float64)
            between = problem.prior.across * (every[1:] - every[:-1])
            self._varied = torch.kron(every, inside) + torch.kron(
                between.T @ between, torch.eye(len(inside), dtype=torch.float64)
            )
            self._varied = self._varied.to(self._gram)

    def inverse(self, second: float, third: float) -> Callable[[Tensor], Tensor]:
        """From inner products with what is left to amounts of the cosines."""
        factor = torch.linalg.cholesky(self._gram + second * self._varied + third * self._unit)

        def solve(amounts: Tensor) -> Tensor:
            solution: Tensor = torch.cholesky_solve(amounts.double()[..., None], factor)
            return solution[..., 0].to(amounts)

        return solve

    def along(self, stack: Tensor) -> Tensor:
        """Inner products with the cosines, (channels, cosines)."""
        return (self._rows @ stack @ self._columns.T).flatten(1)

    def along_image(self, image: Tensor) -> Tensor:
        """Inner products of what is on the sensor with the cosines' images."""
        return (self._images @ image.flatten(1)[..., None])[..., 0]

    def sum(self, amounts: Tensor) -> Tensor:
        """The stack of so much of each."""
        modes = amounts.view(len(amounts), -1, len(self._rows), len(self._columns))
        return self._rows.T @ modes @ self._columns

    def image(self, amounts: Tensor) -> Tensor:
        """What the sensor sees of that."""
        return (amounts[:, None] @ self._images).view(len(amounts), *self._sensor)


def _energies(forward: StackConvolution) -> Tensor:
    """Σ(mh)² of each slice on an endless sensor, mean over channels; float64, (slices,)."""
    own = {each: _energy(each, forward.geometry.padded) for each in forward.operators}
    energies = torch.stack([own[each] for each in forward.operators])
    if forward.masks is None:
        return energies
    return energies * forward.masks.double().square().flatten(1).mean(1).to(energies)


def _energy(operator: CroppedConvolution, padded: tuple[int, int]) -> Tensor:
    at_zero = irfft2(operator.power.to(operator.transfer.dtype), padded)[:, 0, 0]
    return at_zero.double().mean()
