"""Whole jobs, from files to files: what the command line runs, and programs can call."""

from nolens.jobs.camera_facts import camera_facts
from nolens.jobs.demo import DemoResult, run_demo
from nolens.jobs.fabricate import fabricate
from nolens.jobs.fabricate_options import FabricateOptions
from nolens.jobs.given import expand_home
from nolens.jobs.mask import MaskOutcome, design_mask
from nolens.jobs.mask_options import MaskOptions
from nolens.jobs.material_facts import material_facts
from nolens.jobs.options import Method, ReconstructOptions
from nolens.jobs.psf import PsfOutcome, simulate_psf
from nolens.jobs.reconstruct import Outcome, reconstruct
from nolens.jobs.relief import ReliefOutcome, replace_relief
from nolens.jobs.relief_options import ReliefOptions
from nolens.jobs.reporter import Reporter
from nolens.jobs.scene_options import PsfOptions, SimulateOptions
from nolens.jobs.simulate import SimulationOutcome, simulate
from nolens.jobs.thickness import ThicknessOutcome, design_thickness
from nolens.jobs.thickness_options import ThicknessOptions
from nolens.jobs.tolerance import ToleranceOutcome, study_tolerances, tolerances_text
from nolens.jobs.tolerance_options import ToleranceOptions

__all__ = [
    "DemoResult",
    "FabricateOptions",
    "MaskOptions",
    "MaskOutcome",
    "Method",
    "Outcome",
    "PsfOptions",
    "PsfOutcome",
    "ReconstructOptions",
    "ReliefOptions",
    "ReliefOutcome",
    "Reporter",
    "SimulateOptions",
    "SimulationOutcome",
    "ThicknessOptions",
    "ThicknessOutcome",
    "ToleranceOptions",
    "ToleranceOutcome",
    "camera_facts",
    "design_mask",
    "design_thickness",
    "expand_home",
    "fabricate",
    "material_facts",
    "reconstruct",
    "replace_relief",
    "run_demo",
    "simulate",
    "simulate_psf",
    "study_tolerances",
    "tolerances_text",
]
