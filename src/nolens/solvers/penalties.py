"""Penalties of ADMM: the start, and their balance while it runs."""

import math
from dataclasses import dataclass

from nolens.kernels import PassSums

Penalties = tuple[float, float, float]
"""μ₁, μ₂, μ₃ of the splits x = Mv, u = Ψv, w = v."""

START: Penalties = (0.01, 1.0, 1.0)


@dataclass(frozen=True)
class Balance:
    r"""Scales all penalties by one factor an iteration until multipliers and splits move alike.

    With R = (Σ μ‖Δd‖² / Σ μ‖Δx‖²)^½, the way that the scaled multipliers d went against the
    way that the splits x went, both in the metric of the penalties, every penalty is
    multiplied by (R / target)^rate, at most by `limit`. Residual balancing (`boyd2011`,
    § 3.4.1) compares the same two for one split; `docs/decisions/0002-penalties.md` has what
    was measured.
    """

    target: float = 1.0
    rate: float = 0.5
    limit: float = 1.2

    def next(self, penalties: Penalties, sums: list[PassSums]) -> Penalties:
        """Penalties of the next iteration, from the sums of every channel's pass."""
        turned = moved = 0.0
        for each in sums:
            for mu, d, x in zip(penalties, each.multiplier_change, each.change, strict=True):
                turned += mu * d
                moved += mu * x
        if not (turned > 0 and moved > 0):
            return penalties
        factor = (math.sqrt(turned / moved) / self.target) ** self.rate
        factor = min(max(factor, 1 / self.limit), self.limit)
        first, second, third = penalties
        return first * factor, second * factor, third * factor
