"""The stream of the live view: total variation, and a trained prior where it keeps the rate."""

from threading import Thread

from torch import Tensor

from nolens.errors import DivergenceError, NolensError
from nolens.solvers import Problem, Stream
from nolens.solvers.plug_and_play import PlugAndPlay
from nolens.solvers.stream import Frame
from nolens.solvers.trained_stream import TrainedStream

_LATENCY_S = 0.25
"""Most of a frame by total variation."""
_TRAINED_S = 0.08
"""Most of a frame by the trained prior: a tenth of a second, less what development, JPEG and the
way to the page take."""
_FEWEST_TURNS = 3
"""In that time: with fewer, what moves is followed less well than by total variation (decision
24)."""
_TRIES = 3
"""Frames one of which must have them; other work may delay the first."""
_HOPELESS = 4.0
"""Times the time, from which on there is no other try."""
_SETTLED = 8
"""Frames of a scene after which total variation has found it (decision 24)."""


class LiveStream:
    """Reconstructs frame after frame of one scene after the other.

    A scene begins by total variation, which follows a cut within three frames. Once it has settled,
    a thread beside it begins with the trained prior and measures what a frame takes. Where that
    keeps ten frames a second, the next frames are by the trained prior until a cut; elsewhere all
    stay by total variation.

    Parameters
    ----------
    problem
        Of the first frame; all others have its sizes.
    iterations
        Of a frame by total variation.
    """

    def __init__(self, problem: Problem, iterations: int) -> None:
        self.iterations = iterations
        self._problem = problem
        self._variation = Stream(problem, iterations=iterations, latency_s=_LATENCY_S)
        self._network: PlugAndPlay | None = None
        self._turns: TrainedStream | None = None
        self._begun: TrainedStream | None = None
        self._newest = problem.data, problem.valid
        self._settled = 0
        self._thread: Thread | None = None
        self._is_slow = False

    @property
    def cuts(self) -> int:
        """Changes of the scene so far."""
        return self._variation.cuts

    @property
    def facts(self) -> dict[str, str]:
        """What a record says of the prior of the last frame."""
        if self._turns is None or self._network is None:
            return {"prior": self._problem.prior.value}
        return self._network.facts

    def weigh(self, weight: float) -> None:
        """Go on with another weight of total variation, as `Stream.weigh`."""
        self._variation.weigh(weight)

    def solve(self, values: Tensor, valid: Tensor, network: PlugAndPlay | None) -> Frame:
        """Reconstruct the next frame.

        Parameters
        ----------
        values, valid
            As `Stream.solve` takes them.
        network
            The trained prior; None for total variation alone.

        Raises
        ------
        NolensError
            As `Stream.solve` and `TrainedStream.solve`.
        """
        if network is not self._network:
            self._network, self._turns, self._begun, self._settled = network, None, None, 0
        if self._turns is None and self._begun is not None:
            self._turns, self._begun = self._begun, None
        if self._turns is not None:
            return self._by_turns(self._turns, values, valid)
        cuts = self.cuts
        solved = self._variation.solve(values, valid)
        self._settled = self._settled + 1 if self.cuts == cuts else 0
        if network is not None and self._settled >= _SETTLED and not self._is_slow:
            self._begin(network, values, valid, solved.scene)
        return solved

    def wait(self) -> None:
        """Until the thread beside has ended."""
        if self._thread is not None:
            self._thread.join()

    def _by_turns(self, turns: TrainedStream, values: Tensor, valid: Tensor) -> Frame:
        """The next frame, and no other by these turns where it is of another scene."""
        cuts, self._newest = turns.cuts, (values, valid)
        try:
            solved = turns.solve(values, valid)
        except DivergenceError:
            self._turns, self._settled = None, 0
            raise
        if turns.cuts > cuts:
            self._turns, self._settled = None, 0
        return solved

    def _photo(self, _: Problem, callback: object) -> Frame:
        """What turns have in place of a photo where the scene changes: total variation's frame."""
        return self._variation.solve(*self._newest)

    def _begin(self, network: PlugAndPlay, values: Tensor, valid: Tensor, scene: Tensor) -> None:
        if self._thread is None or not self._thread.is_alive():
            given = network, values, valid, scene
            self._thread = Thread(target=self._try_turns, args=given, daemon=True)
            self._thread.start()

    def _try_turns(
        self, network: PlugAndPlay, values: Tensor, valid: Tensor, scene: Tensor
    ) -> None:
        """Have the next frames by turns that begin with a scene, where they keep the rate."""
        turns = TrainedStream(self._problem, network, self._photo, latency_s=_TRAINED_S)
        try:
            turns.start(values, valid, scene)
            for _ in range(_TRIES):
                solved = turns.solve(values, valid)
                if solved.iterations >= _FEWEST_TURNS:
                    if network is self._network:
                        self._begun = turns
                    return
                if solved.seconds > _HOPELESS * _TRAINED_S:
                    break
        except (NolensError, ArithmeticError):
            return  # Another frame may be better.
        self._is_slow = True
