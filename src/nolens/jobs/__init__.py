"""Whole jobs, from files to files: what the command line runs, and programs can call."""

from nolens.jobs.camera_facts import camera_facts
from nolens.jobs.demo import DemoResult, run_demo
from nolens.jobs.given import expand_home
from nolens.jobs.options import Method, ReconstructOptions
from nolens.jobs.psf import PsfOutcome, simulate_psf
from nolens.jobs.reconstruct import Outcome, reconstruct
from nolens.jobs.reporter import Reporter
from nolens.jobs.scene_options import PsfOptions, SimulateOptions
from nolens.jobs.simulate import SimulationOutcome, simulate

__all__ = [
    "DemoResult",
    "Method",
    "Outcome",
    "PsfOptions",
    "PsfOutcome",
    "ReconstructOptions",
    "Reporter",
    "SimulateOptions",
    "SimulationOutcome",
    "camera_facts",
    "expand_home",
    "reconstruct",
    "run_demo",
    "simulate",
    "simulate_psf",
]
