"""Solvers: plain functions from a `Problem` to a `Result`."""

from nolens.solvers.admm import admm, admm_bytes
from nolens.solvers.admm_state import AdmmState
from nolens.solvers.data_terms import DataTerm, Gaussian, Poisson
from nolens.solvers.deepinv import deepinv_denoiser, deepinv_physics
from nolens.solvers.denoiser import Denoiser
from nolens.solvers.development import Developed, Development, FieldPoint
from nolens.solvers.fista import fista
from nolens.solvers.functionals import (
    L1,
    Box,
    Functional,
    GroupSparsity,
    NonNegative,
    OpponentL1,
    Ridge,
    Support,
    TotalVariation,
)
from nolens.solvers.held_out import Weight
from nolens.solvers.minimise import minimise
from nolens.solvers.primal_dual import primal_dual
from nolens.solvers.problem import Prior, Problem
from nolens.solvers.proximal_gradient import proximal_gradient
from nolens.solvers.psf_choice import PsfChoice, PsfSettings, choose_psf, geometry_row
from nolens.solvers.reconstructor import Method, Reconstructor, stop_of
from nolens.solvers.result import STOPS, Progress, Quality, Result, Stop
from nolens.solvers.scene_support import SupportChoice
from nolens.solvers.split_admm import split_admm
from nolens.solvers.stack import StackPrior, StackProblem, stack_bytes
from nolens.solvers.stream import Frame, Live, Stream
from nolens.solvers.wiener import circulant_wiener, wiener

__all__ = [
    "L1",
    "STOPS",
    "AdmmState",
    "Box",
    "DataTerm",
    "Denoiser",
    "Developed",
    "Development",
    "FieldPoint",
    "Frame",
    "Functional",
    "Gaussian",
    "GroupSparsity",
    "Live",
    "Method",
    "NonNegative",
    "OpponentL1",
    "Poisson",
    "Prior",
    "Problem",
    "Progress",
    "PsfChoice",
    "PsfSettings",
    "Quality",
    "Reconstructor",
    "Result",
    "Ridge",
    "StackPrior",
    "StackProblem",
    "Stop",
    "Stream",
    "Support",
    "SupportChoice",
    "TotalVariation",
    "Weight",
    "admm",
    "admm_bytes",
    "choose_psf",
    "circulant_wiener",
    "deepinv_denoiser",
    "deepinv_physics",
    "fista",
    "geometry_row",
    "minimise",
    "primal_dual",
    "proximal_gradient",
    "split_admm",
    "stack_bytes",
    "stop_of",
    "wiener",
]
