"""A course of training: batch after batch, with checks on pictures that are held out."""

import math
from collections.abc import Iterable, Mapping
from typing import Any, Protocol

import torch
from torch import Tensor

from nolens.errors import DivergenceError
from nolens.progress import ProgressCallback
from nolens.solvers.denoising_network import DenoisingNetwork
from nolens.training.denoising import Trainer, network_of, prefixed, without_prefix
from nolens.training.validation import ALL, HeldOut

_CHECKS, _STEPS_BETWEEN, _OF_A_LONG_ONE = 8, 250, 30
"""At least so many checks, and no more steps between them, but no more than so many checks."""


class Lessons(Protocol):
    """What a network learns from."""

    def begin(self, trainer: Trainer, progress: ProgressCallback) -> None:
        """Make what has to be there before the first batch, or before that of a resumed run."""

    def losses(self, trainer: Trainer) -> Iterable[Tensor]:
        """Of the next step."""


class Course:
    """Steps of a trainer, until there are enough or the network gets no better.

    The network that it starts from is measured first, and is the best one until another is better.

    Parameters
    ----------
    trainer
        Network and optimiser.
    lessons
        Its batches.
    held_out
        What the network is checked by.
    patience
        Checks without a better score after which it ends.

    Attributes
    ----------
    history
        A row for each check: step, mean loss since the one before, score in dB.
    scores
        Of the best network so far, by kind of picture.
    scores_start
        Of the network that it starts from.

    Raises
    ------
    DivergenceError
        If that network gives NaN or infinity.
    """

    def __init__(
        self, trainer: Trainer, lessons: Lessons, held_out: HeldOut, patience: int
    ) -> None:
        self.trainer, self.patience = trainer, patience
        self._lessons, self._held_out = lessons, held_out
        first = trainer.trained()
        self.scores_start = held_out.scores(first)
        if not math.isfinite(self.scores_start[ALL]):
            raise DivergenceError(
                "the weights to start from give NaN or infinity on the pictures held out: give "
                "others (--start)"
            )
        self._best, self.scores = first.state_dict(), self.scores_start
        self.history: list[dict[str, float]] = []
        self._losses: list[Tensor] = []
        self._since_best = 0

    @property
    def best(self) -> DenoisingNetwork:
        """The network with the best score so far."""
        return network_of(self._best, like=self.trainer.network)

    @property
    def best_step(self) -> int:
        """After which step the network was the best; 0 is the one that it starts from."""
        if self.scores[ALL] <= self.scores_start[ALL]:
            return 0
        return int(max(self.history, key=lambda row: row["validation_db"])["step"])

    @property
    def got_no_better(self) -> bool:
        """Whether the last checks brought no better score."""
        return self._since_best >= self.patience

    @property
    def ended(self) -> bool:
        """Whether there is no more to do."""
        return self.trainer.step >= self.trainer.schedule.steps or self.got_no_better

    def advance(self) -> None:
        """Do one step, and check the network where that is due."""
        self._losses.append(self.trainer.learn(self._lessons.losses(self.trainer)))
        steps = self.trainer.schedule.steps
        longest = max(_STEPS_BETWEEN, math.ceil(steps / _OF_A_LONG_ONE))
        between = min(longest, math.ceil(steps / _CHECKS))
        if self.trainer.step % between == 0 or self.trainer.step == steps:
            self.check()

    def check(self) -> None:
        """Measure the network as it is; nothing where that was done at this step.

        Raises
        ------
        DivergenceError
            If a loss since the last check, or the score, is NaN or infinite.
        """
        if self.history and self.history[-1]["step"] == self.trainer.step:
            return
        losses = self._finite_losses()
        network = self.trainer.trained()
        scores = self._held_out.scores(network)
        self._check_finite(scores[ALL])
        loss = sum(losses) / max(len(losses), 1)
        self.history.append({"step": self.trainer.step, "loss": loss, "validation_db": scores[ALL]})
        self._losses, self._since_best = [], self._since_best + 1
        if scores[ALL] > self.scores[ALL]:
            self.scores, self._since_best = scores, 0
            self._best = network.state_dict()

    def _finite_losses(self) -> list[float]:
        """Since the last check; to look at each step's would make a CUDA device wait."""
        losses = [float(each) for each in self._losses]
        self._check_finite(*losses)
        return losses

    def _check_finite(self, *values: float) -> None:
        if not all(map(math.isfinite, values)):
            raise DivergenceError(
                f"the training gave NaN or infinity by step {self.trainer.step}: give a smaller "
                f"--rate than {self.trainer.schedule.rate:g}"
            )

    def arrays(self) -> dict[str, Tensor]:
        """All tensors that `restore` needs, by name."""
        return {**self.trainer.arrays(), **prefixed("best", self._best)}

    def like_arrays(self) -> dict[str, Tensor]:
        """Tensors of the shapes and types that `arrays` has after the first step."""
        return {**self.trainer.like_arrays(), **prefixed("best", self._best)}

    def figures(self) -> dict[str, Any]:
        """All that `restore` needs beside the tensors, in values that JSON has.

        Raises
        ------
        DivergenceError
            If a loss since the last check is NaN or infinite.
        """
        return {
            "step": self.trainer.step,
            "scores": dict(self.scores),
            "history": list(self.history),
            "losses": self._finite_losses(),
            "since_best": self._since_best,
        }

    def restore(self, arrays: Mapping[str, Tensor], figures: Mapping[str, Any]) -> None:
        """Go on where another course stood, by its `arrays` and `figures`.

        Its best network counts where it is better than the one that this course starts from:
        checkpoints of before did not compare the two.

        Raises
        ------
        KeyError, TypeError, ValueError
            If they are none of a course.
        """
        self.trainer.restore(arrays, int(figures["step"]))
        self.history = [
            {str(name): each[name] for name in ("step", "loss", "validation_db")}
            for each in figures["history"]
        ]
        scores = {str(name): float(each) for name, each in figures["scores"].items()}
        if scores.get(ALL, -math.inf) > self.scores[ALL]:
            self._best, self.scores = without_prefix("best", arrays), scores
        self._losses = [torch.tensor(float(each)) for each in figures["losses"]]
        self._since_best = int(figures["since_best"])
