"""Whole jobs, from files to files: what the command line runs, and programs can call."""

from nolens.jobs.demo import DemoResult, run_demo
from nolens.jobs.options import Method, ReconstructOptions, expand_home
from nolens.jobs.reconstruct import Outcome, Reporter, reconstruct

__all__ = [
    "DemoResult",
    "Method",
    "Outcome",
    "ReconstructOptions",
    "Reporter",
    "expand_home",
    "reconstruct",
    "run_demo",
]
