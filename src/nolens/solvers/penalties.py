"""Penalties of ADMM: the start, and their balance while it runs."""

import math
from dataclasses import dataclass

from nolens.kernels import PassSums

Penalties = tuple[float, float, float]
"""μ₁, μ₂, μ₃ of the splits x = Mv, u = Ψv, w = v."""

LOOK = 4
"""Iterations from one convergence check to the next: residuals, balance, stop."""

START: Penalties = (0.02, 2.0, 1.0)


@dataclass(frozen=True)
class Balance:
    r"""Balances penalties until multipliers and splits move alike.

    For each split, Rᵢ = ‖Δdᵢ‖ / ‖Δxᵢ‖ compares the way that its scaled multiplier went in an
    iteration with the way that the split itself went, and R does so for all of them, in the
    metric of the penalties: R² = Σμᵢ‖Δdᵢ‖² / Σμᵢ‖Δxᵢ‖². Residual balancing (`boyd2011`,
    § 3.4.1; `he2000`) keeps such a ratio near one. Here, after every check,

    - all penalties grow by `growth` while R exceeds `target`: they start small, where the
      measurement is met at once, and end where the splits agree;
    - each is multiplied by (Rᵢ/R)^`rate`, at most by `limit`, so that no split is left behind.

    After `span` iterations the penalties stay as they are, without which ADMM need not
    converge (`he2000`). `docs/decisions/0002-penalties.md` has what was measured.
    """

    growth: float = 1.31
    target: float = 0.7
    rate: float = 0.34
    limit: float = 1.46
    span: int = 100

    def next(self, penalties: Penalties, sums: list[PassSums], iteration: int) -> Penalties:
        """Penalties after `iteration`, from the sums of every channel's last pass."""
        if iteration > self.span:
            return penalties
        turned = [sum(each.multiplier_change[k] for each in sums) for k in range(3)]
        moved = [sum(each.change[k] for each in sums) for k in range(3)]
        all_turned = sum(mu * d for mu, d in zip(penalties, turned, strict=True))
        all_moved = sum(mu * x for mu, x in zip(penalties, moved, strict=True))
        if not (all_turned > 0 and all_moved > 0):
            return penalties
        ratio = math.sqrt(all_turned / all_moved)
        growth = self.growth if ratio > self.target else 1.0
        first, second, third = (
            mu * growth * self._step(d, x, ratio)
            for mu, d, x in zip(penalties, turned, moved, strict=True)
        )
        return first, second, third

    def _step(self, turned: float, moved: float, ratio: float) -> float:
        if turned == 0 or moved == 0:
            return 1.0
        step = math.pow(math.sqrt(turned / moved) / ratio, self.rate)
        return min(max(step, 1 / self.limit), self.limit)
