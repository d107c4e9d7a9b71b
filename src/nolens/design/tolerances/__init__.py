"""How far off a camera may be made, and what its parameters do to the sharpness of its PSF.

Everything here takes a criterion as a plain function of the parameters' values, so that what is
known of a formula is known of a camera too. `models` has the two criteria of cameras.
"""

from nolens.design.tolerances.builds import (
    Builds,
    check_possible,
    largest_possible,
    leaves_thickness,
)
from nolens.design.tolerances.criterion import Criterion, evaluate
from nolens.design.tolerances.distributions import DISTRIBUTIONS, Parameter, draw, shares
from nolens.design.tolerances.inverse import MOST_STEPS, Allowed, largest_tolerance
from nolens.design.tolerances.models import RayModel, WaveModel, criterion_of
from nolens.design.tolerances.patch import Lenslets, Patch
from nolens.design.tolerances.sensitivity import (
    Prediction,
    Response,
    Sensitivity,
    respond,
    sweep,
)
from nolens.design.tolerances.sharpness import Sharpness
from nolens.design.tolerances.study import BudgetLine, Study
from nolens.design.tolerances.table import parameters_from_toml, parameters_to_toml
from nolens.design.tolerances.trials import LEVELS, Yield, levels
from nolens.design.tolerances.variables import (
    Variable,
    default_parameters,
    find,
    variables,
)

__all__ = [
    "DISTRIBUTIONS",
    "LEVELS",
    "MOST_STEPS",
    "Allowed",
    "BudgetLine",
    "Builds",
    "Criterion",
    "Lenslets",
    "Parameter",
    "Patch",
    "Prediction",
    "RayModel",
    "Response",
    "Sensitivity",
    "Sharpness",
    "Study",
    "Variable",
    "WaveModel",
    "Yield",
    "check_possible",
    "criterion_of",
    "default_parameters",
    "draw",
    "evaluate",
    "find",
    "largest_possible",
    "largest_tolerance",
    "leaves_thickness",
    "levels",
    "parameters_from_toml",
    "parameters_to_toml",
    "respond",
    "shares",
    "sweep",
    "variables",
]
