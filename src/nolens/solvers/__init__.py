"""Solvers: plain functions from a `Problem` to a `Result`."""

from nolens.solvers.admm import admm
from nolens.solvers.admm_state import AdmmState
from nolens.solvers.fista import fista
from nolens.solvers.live import Live
from nolens.solvers.problem import Prior, Problem
from nolens.solvers.quality import STOPS, Quality, Stop
from nolens.solvers.result import Progress, Result
from nolens.solvers.stream import Frame, Stream
from nolens.solvers.wiener import wiener

__all__ = [
    "STOPS",
    "AdmmState",
    "Frame",
    "Live",
    "Prior",
    "Problem",
    "Progress",
    "Quality",
    "Result",
    "Stop",
    "Stream",
    "admm",
    "fista",
    "wiener",
]
