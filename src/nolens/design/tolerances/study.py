"""All that was found about how far off a camera may be made."""

from dataclasses import dataclass

from torch import Tensor

from nolens.amounts import amount
from nolens.design.tolerances.inverse import Allowed
from nolens.design.tolerances.sensitivity import Response
from nolens.design.tolerances.sharpness import Sharpness
from nolens.design.tolerances.trials import Yield, levels


@dataclass(frozen=True)
class BudgetLine:
    """One line of a tolerance budget.

    Parameters
    ----------
    parameter
        Its name.
    nominal
        Its middle value.
    allowed
        ±.
    unit
        Of both; empty for an index.
    effect
        What the criterion does at − and + that, as text.
    """

    parameter: str
    nominal: float
    allowed: float
    unit: str
    effect: str


@dataclass(frozen=True)
class Study:
    """Sensitivities, trials and what follows from them.

    Parameters
    ----------
    sharpness
        The criterion.
    response
        Around the middle of all parameters.
    cameras
        Cameras that were drawn, (trials, parameters).
    figures
        Their criterion, (trials,); infinite where nothing could be measured.
    curves
        By the name of a parameter, its values and the criterion at them.
    limit
        What a camera must meet; None: nobody asked.
    solved
        Name of the parameter whose tolerance was asked for, the yield that was wanted, and what
        was found.
    """

    sharpness: Sharpness
    response: Response
    cameras: Tensor
    figures: Tensor
    curves: dict[str, tuple[Tensor, Tensor]]
    limit: float | None = None
    solved: tuple[str, float, Allowed] | None = None

    @property
    def levels(self) -> dict[float, float]:
        """See `nolens.design.tolerances.trials.levels`."""
        return levels(self.figures, smaller_is_better=self.sharpness.smaller_is_better)

    @property
    def passed(self) -> Yield | None:
        """Cameras that met the limit."""
        if self.limit is None:
            return None
        better = self.sharpness.smaller_is_better
        return Yield.of(self.figures, self.limit, smaller_is_better=better)

    @property
    def budget(self) -> tuple[BudgetLine, ...]:
        """Lines for the process sheet, the worst offender first."""
        unit = self.sharpness.unit
        return tuple(
            BudgetLine(
                row.parameter.name,
                row.parameter.middle,
                row.parameter.tolerance,
                row.parameter.unit,
                f"{self.sharpness.name} {amount(row.minus, digits=2, sign=True)} / "
                f"{amount(row.plus, unit, digits=2, sign=True)}",
            )
            for row in self.response.sensitivities
        )
