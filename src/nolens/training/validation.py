"""Pictures that nothing is learnt from, and how near a network comes to them."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
import torch
from torch import Tensor

from nolens.progress import ProgressCallback
from nolens.solvers.denoising_network import STEP, DenoisingNetwork, noise_planes
from nolens.solvers.plug_and_play import PlugAndPlay, Refinement
from nolens.training.cameras import TrainingCamera
from nolens.training.measurements import Example, Shot, random_size, reconstruct_shot, simulate
from nolens.training.patches import photograph_patch
from nolens.training.pictures import training_picture

MOST_GENERATED = 900_000
"""Pictures of a pool: seeds from here on to the next pool's are those of pictures held out."""
ALL = "all"
_SEED = 5
_SIDE = 96
"""Of a picture without noise; a measurement's has its own."""
_SIGMAS = 0.03, 0.1, 0.3
_NOISY, _MEASURED = 12, 6
"""How many generated ones."""
_OF_A_PHOTOGRAPH = 3


@dataclass(frozen=True)
class HeldOut:
    """Pictures, by kind, and how near a network comes to each.

    Parameters
    ----------
    items
        What a network is measured by, by the kind of picture.
    score
        Of a network on an item, in dB.
    before
        Of an item without any network, in dB.
    """

    items: Mapping[str, Sequence[object]] = field(repr=False)
    score: Callable[[DenoisingNetwork, object], float]
    before: Callable[[object], float]

    def scores(self, network: DenoisingNetwork) -> dict[str, float]:
        """Mean of each kind in dB, and of `ALL`."""
        return self._means(lambda item: self.score(network, item))

    def scores_before(self) -> dict[str, float]:
        """The same without any network."""
        return self._means(self.before)

    def _means(self, score: Callable[[object], float]) -> dict[str, float]:
        each = {kind: [score(item) for item in items] for kind, items in self.items.items()}
        every = [value for values in each.values() for value in values]
        means = {kind: float(np.mean(values)) for kind, values in each.items() if values}
        return {ALL: float(np.mean(every)), **means}


@dataclass(frozen=True)
class _Noisy:
    clean: Tensor
    noisy: Tensor
    sigma: float


def noisy_pictures(photographs: Sequence[Tensor] = ()) -> HeldOut:
    """Pictures with white noise of three strengths.

    Parameters
    ----------
    photographs
        Beside generated ones.
    """
    random = _random()

    def noisy(clean: Tensor) -> list[_Noisy]:
        return [_Noisy(clean, clean + sigma * _noise(random, clean), sigma) for sigma in _SIGMAS]

    side = min([_SIDE, *(each for those in photographs for each in those.shape[1:])])
    pictures = _pictures(random, photographs, _NOISY, lambda: side // STEP * STEP)
    items = {
        kind: [each for clean in those for each in noisy(clean)] for kind, those in pictures.items()
    }
    return HeldOut(items, _denoised_db, _noisy_db)


def measured_pictures(
    prior: PlugAndPlay,
    camera: TrainingCamera | None = None,
    photographs: Sequence[Tensor] = (),
    pairs: Sequence[Shot] = (),
    progress: ProgressCallback | None = None,
    refinement: Callable[[DenoisingNetwork], Refinement] = Refinement,
) -> HeldOut:
    """Measurements of pictures, reconstructed by turns; a network mends what they leave.

    Parameters
    ----------
    prior
        Whose turns they are.
    camera
        That measures; None takes another one for each picture.
    photographs
        Beside generated ones.
    pairs
        Real measurements, beside simulated ones.
    progress
        Called with the fraction that is done.
    refinement
        Of a network.
    """
    random = _random()
    pictures = _pictures(random, photographs, _MEASURED, lambda: random_size(random)[0])
    items: dict[str, list[Example]] = {kind: [] for kind in (*pictures, *(["pairs"] * bool(pairs)))}
    done, count = 0, sum(map(len, pictures.values())) + len(pairs)

    def add(kind: str, shot: Shot) -> None:
        nonlocal done
        items[kind].append(reconstruct_shot(shot, prior, random))
        done += 1
        if progress is not None:
            progress(done / count)

    for kind, those in pictures.items():
        for picture in those:
            add(kind, simulate(random, picture, random_size(random)[1], camera))
    for shot in pairs:
        add("pairs", shot)
    return HeldOut(items, lambda network, item: _refined_db(refinement(network), item), _turn_db)


def _random() -> np.random.Generator:
    return np.random.Generator(np.random.Philox(_SEED))


def _pictures(
    random: np.random.Generator,
    photographs: Sequence[Tensor],
    count: int,
    side: Callable[[], int],
) -> dict[str, list[Tensor]]:
    sides = [side() for _ in range(count)]
    generated = [
        training_picture(each, each, MOST_GENERATED + number) for number, each in enumerate(sides)
    ]
    if not photographs:
        return {"generated": generated}
    cuts = [
        photograph_patch(random, each, min(side(), *each.shape[1:]))
        for each in photographs
        for _ in range(_OF_A_PHOTOGRAPH)
    ]
    return {"generated": generated, "photographs": cuts}


def _noise(random: np.random.Generator, like: Tensor) -> Tensor:
    return torch.from_numpy(random.standard_normal(tuple(like.shape), np.float32))


def _denoised_db(network: DenoisingNetwork, item: object) -> float:
    assert isinstance(item, _Noisy)
    with torch.inference_mode():
        planes = noise_planes(torch.full((1, 3), item.sigma))
        return _db(network(item.noisy[None], planes)[0] - item.clean)


def _noisy_db(item: object) -> float:
    assert isinstance(item, _Noisy)
    return _db(item.noisy - item.clean)


def _refined_db(refinement: Refinement, item: object) -> float:
    assert isinstance(item, Example)
    with torch.inference_mode():
        return _db(refinement(item.turn) - item.truth, float(item.truth.max()))


def _turn_db(item: object) -> float:
    assert isinstance(item, Example)
    return _db(item.turn.picture - item.truth, float(item.truth.max()))


def _db(error: Tensor, white: float = 1.0) -> float:
    return -10 * float(torch.log10(((error / white).square().mean()).clamp_min(1e-12)))
