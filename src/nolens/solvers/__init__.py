"""Solvers: plain functions from a `Problem` to a `Result`."""

from nolens.solvers.admm import admm, admm_bytes
from nolens.solvers.admm_state import AdmmState
from nolens.solvers.development import Developed, Development
from nolens.solvers.fista import fista
from nolens.solvers.held_out import Weight
from nolens.solvers.problem import Prior, Problem
from nolens.solvers.psf_choice import PsfChoice, PsfSettings, choose_psf, geometry_row
from nolens.solvers.reconstructor import Method, Reconstructor, stop_of
from nolens.solvers.result import STOPS, Progress, Quality, Result, Stop
from nolens.solvers.scene_support import SupportChoice
from nolens.solvers.stream import Frame, Live, Stream
from nolens.solvers.wiener import wiener

__all__ = [
    "STOPS",
    "AdmmState",
    "Developed",
    "Development",
    "Frame",
    "Live",
    "Method",
    "Prior",
    "Problem",
    "Progress",
    "PsfChoice",
    "PsfSettings",
    "Quality",
    "Reconstructor",
    "Result",
    "Stop",
    "Stream",
    "SupportChoice",
    "Weight",
    "admm",
    "admm_bytes",
    "choose_psf",
    "fista",
    "geometry_row",
    "stop_of",
    "wiener",
]
