"""scico's plug-and-play (0.0.7, BSD-3-Clause), run by `.bench-venv/scico` for priors_peer.py.

How it is posed. As scico's example of deconvolution with DnCNN does: the misfit on the sensor's
pixels is f of its ADMM, its linear step conjugate gradients, and its `DnCNN` with the weights that
come with scico stands for the proximal map of g = 1, each colour by itself. The scene is the
pixels that light can come from. A PSF has unit l2 norm, and the picture the white of a photograph
by total variation as 1, as the network was trained on pictures from 0 to 1.

The penalty weighs the misfit against the network. scico ships none for this problem, so two are
tried, (σ / s)² and four times that, with the noise σ of a pixel and the noise s that the network
was trained for; priors_peer.py takes the one that is better for the truth. It starts where nolens
starts, from a photograph by total variation: from 0, the slow part of a scene is far from there
after sixteen iterations (astronaut, 13.8 dB).
"""

from __future__ import annotations

import sys
from time import perf_counter

import jax
import jax.numpy as jnp
import numpy as np
import numpy.typing as npt
import scico.numpy as snp
from scico.functional import DnCNN
from scico.linop import Identity, LinearOperator
from scico.loss import SquaredL2Loss
from scico.optimize.admm import ADMM, LinearSubproblemSolver

VARIANT, TRAINED_FOR = "17L", 0.06
"""Of the network, with 17 layers, and the noise that it was trained for."""
FACTORS = (1.0, 4.0)
ITERATIONS, INNER = 12, 20

Array = npt.NDArray[np.float32]


class Colours(DnCNN):  # type: ignore[misc]
    """The network for one colour after the other, (channels, height, width)."""

    def prox(self, v: jax.Array, lam: float = 1.0, **more: object) -> jax.Array:
        """Each colour without its noise."""
        return snp.stack([DnCNN.prox(self, each, lam, **more) for each in v])


def operator(kernel: Array, sensor: list[int], scene: list[int]) -> LinearOperator:
    """From the pixels that light can come from to the sensor's."""
    transfer = jnp.fft.rfft2(jnp.asarray(kernel))
    padded = kernel.shape[-2:]

    def light(pixels: jax.Array) -> jax.Array:
        top, left, height, width = scene
        placed = jnp.zeros(kernel.shape, jnp.float32)
        placed = placed.at[:, top : top + height, left : left + width].set(pixels)
        whole = jnp.fft.irfft2(jnp.fft.rfft2(placed) * transfer, s=padded)
        top, left, height, width = sensor
        return whole[:, top : top + height, left : left + width]

    return LinearOperator(
        input_shape=(len(kernel), *scene[2:]),
        output_shape=(len(kernel), *sensor[2:]),
        eval_fn=light,
        input_dtype=jnp.float32,
        output_dtype=jnp.float32,
        jit=True,
    )


def noise_of(data: Array) -> float:
    """Of a pixel, by differences along both sides, in which little of a picture is left."""
    twice = data[:, 1:, 1:] - data[:, 1:, :-1] - data[:, :-1, 1:] + data[:, :-1, :-1]
    return float(np.median(np.abs(twice)) / 0.6745 / 2)


def main() -> None:
    """Read a case, and write a picture for each penalty, and the seconds that it took."""
    source, target = sys.argv[1:]
    with np.load(source) as case:
        kernel, data = case["kernel"], case["data"]
        forward = operator(kernel, case["sensor"].tolist(), case["scene"].tolist())
        start = snp.array(case["start"])
    unit = (noise_of(data) / TRAINED_FOR) ** 2
    pictures, seconds = [], []
    for factor in FACTORS:
        begun = perf_counter()
        solver = ADMM(
            f=SquaredL2Loss(y=snp.array(data), A=forward, scale=0.5),
            g_list=[Colours(VARIANT)],
            C_list=[Identity(forward.input_shape)],
            rho_list=[factor * unit],
            x0=start,
            maxiter=ITERATIONS,
            subproblem_solver=LinearSubproblemSolver(cg_kwargs={"tol": 1e-7, "maxiter": INNER}),
        )
        pictures.append(np.asarray(solver.solve()))
        seconds.append(perf_counter() - begun)
    np.savez(target, pictures=np.stack(pictures), seconds=seconds)


if __name__ == "__main__":
    main()
