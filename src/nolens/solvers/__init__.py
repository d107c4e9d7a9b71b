"""Solvers: plain functions from a `Problem` to a `Result`."""

from nolens.solvers.admm import admm
from nolens.solvers.fista import fista
from nolens.solvers.problem import Prior, Problem
from nolens.solvers.result import Progress, Result
from nolens.solvers.wiener import wiener

__all__ = ["Prior", "Problem", "Progress", "Result", "admm", "fista", "wiener"]
