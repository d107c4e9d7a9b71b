"""A camera that is none: every frame is a step wedge, as bright as the exposure makes it."""

from datetime import UTC, datetime

import torch

from nolens.camera import Frame
from nolens.capture import Limits, Shot
from nolens.errors import OptionError

_WHITE = 4095.0


class StepWedge:
    """Source of frames with some steps from dark to bright: ``--source step-wedge:8``."""

    name = "step wedge"
    limits = Limits(exposure_s=(1e-4, 1.0), gain=(1.0, 8.0))

    def __init__(self, steps: str) -> None:
        if steps and not (steps.isdecimal() and 2 <= int(steps) <= 64):
            raise OptionError(f"step-wedge:{steps}: give 2 to 64 steps, such as step-wedge:8")
        self._steps = int(steps or 8)
        self._exposure_s, self._gain = 0.01, 1.0

    def open(self) -> None:
        """Nothing is to be opened."""

    def set(self, *, exposure_s: float, gain: float) -> None:
        self.limits.check(exposure_s, gain)
        self._exposure_s, self._gain = exposure_s, gain

    def shot(self) -> Shot:
        light = torch.linspace(0.1, 1.0, self._steps).repeat_interleave(8).expand(64, -1)
        counts = (1e5 * self._exposure_s * self._gain * light).clamp(max=_WHITE).round()
        frame = Frame(counts[None], ("grey",), None, (0.0,), _WHITE, "uint16", self.name)
        return Shot(frame, datetime.now(UTC), self._exposure_s, self._gain, self.name, {})

    def close(self) -> None:
        """Nothing is to be closed."""
