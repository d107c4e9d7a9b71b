"""The weight of the prior in the live view, chosen beside it from one of its frames."""

import math
import time
from dataclasses import replace
from threading import Thread

from nolens.camera import Measurement
from nolens.errors import NolensError
from nolens.solvers import Method, Problem, Reconstructor
from nolens.solvers.held_out import choose_weight, weight_by_noise
from nolens.solvers.stream import weight_to_follow
from nolens.solvers.wiener_weight import choose_circulant_weight

_PIXELS = 50_000
"""Sensor pixels on which a weight is chosen: a second's work beside the live view."""
_AGAIN_S = 30.0
"""After which the choice is checked."""
_PAUSE_S = 3.0
"""Between two choices, whatever changes."""
_BRIGHTER = 1.5
"""Factor of the exposure that makes the noise another."""
_WIENER = 0.5
"""Weight of the Wiener filter in normalised units, until one is chosen."""


class LiveWeight:
    """Follows the weight that frames ask for: by their noise at once, then by held-out pixels.

    The choice takes as long as some ten frames, so a thread of its own makes it.

    Parameters
    ----------
    reconstructor
        With the PSF, on the pixels of the live view. Another support takes effect with the next
        choice.
    problem
        Of the first frame.
    method
        Whose weight is chosen: ADMM's, or that of the circulant Wiener filter.
    """

    def __init__(self, reconstructor: Reconstructor, problem: Problem, method: Method) -> None:
        self.reconstructor, self._filters = reconstructor, method is Method.WIENER
        if self._filters:
            self.weight = _WIENER / circulant_unit(problem)
        else:
            self.weight = weight_by_noise(problem).tau
        self.choices = 0
        """That were made so far."""
        self._begun_s = -math.inf
        self._about = (0, 0.0)
        self._thread: Thread | None = None

    def follow(self, measurement: Measurement, cuts: int, brightness: float) -> float:
        """The weight of a frame.

        Parameters
        ----------
        measurement
            The frame; another choice may begin with it.
        cuts
            Changes of the scene so far.
        brightness
            Exposure time times gain.
        """
        thread, now, weight = self._thread, time.monotonic(), self.weight
        if (thread is None or not thread.is_alive()) and self._is_due(now, cuts, brightness):
            self._begun_s, self._about = now, (cuts, brightness)
            self._thread = Thread(target=self._choose, args=(measurement,), daemon=True)
            self._thread.start()
        return weight  # That before, however quick the thread is.

    def wait(self) -> None:
        """Until the choice that is being made is there."""
        if self._thread is not None:
            self._thread.join()

    def _is_due(self, now: float, cuts: int, brightness: float) -> bool:
        before_cuts, before = self._about
        since = now - self._begun_s
        other = cuts != before_cuts or not before / _BRIGHTER <= brightness <= before * _BRIGHTER
        return since > (_PAUSE_S if other else _AGAIN_S)

    def _choose(self, measurement: Measurement) -> None:
        height, width = measurement.size
        by = math.ceil(math.sqrt(height * width / _PIXELS))
        reconstructor = self.reconstructor
        try:
            problem = reconstructor.coarse_problem(measurement, by=by)
            if self._filters:
                unit = circulant_unit(problem)
                problem = replace(problem, tau_unit=unit, slow_light=True)
                weight = choose_circulant_weight(problem)
            else:
                weight = choose_weight(problem)
        except (NolensError, ArithmeticError):
            return  # Another frame may be better; the weight so far stays.
        first = self.choices == 0
        self.weight = weight.tau if first else weight_to_follow(self.weight, weight.tau)
        self.choices += 1


def circulant_unit(problem: Problem) -> float:
    """`Problem.tau_unit` of a problem for ADMM, where squares are weighed."""
    return problem.tau_unit**2
