"""Whole jobs, from files to files: what the command line runs, and programs can call."""

from nolens.jobs.calibrate_distances import CalibrateDistancesOutcome, calibrate_distances
from nolens.jobs.calibrate_distances_options import CalibrateDistancesOptions
from nolens.jobs.calibrate_plan import CalibratePlanOutcome, calibrate_plan
from nolens.jobs.calibrate_point import CalibratePointOutcome, calibrate_point
from nolens.jobs.calibrate_point_options import CalibratePointOptions
from nolens.jobs.calibrate_stitch import CalibrateStitchOutcome, calibrate_stitch
from nolens.jobs.calibrate_stitch_options import CalibratePlanOptions, CalibrateStitchOptions
from nolens.jobs.calibrate_surround import CalibrateSurroundOutcome, calibrate_surround
from nolens.jobs.calibrate_surround_options import CalibrateSurroundOptions
from nolens.jobs.camera_facts import camera_facts
from nolens.jobs.demo import DemoResult, run_demo
from nolens.jobs.fabricate import fabricate
from nolens.jobs.fabricate_options import FabricateOptions
from nolens.jobs.given import expand_home
from nolens.jobs.mask import MaskOutcome, design_mask
from nolens.jobs.mask_options import MaskOptions
from nolens.jobs.material_facts import material_facts
from nolens.jobs.measure_field import MeasureFieldOutcome, measure_field
from nolens.jobs.measure_field_options import MeasureFieldOptions
from nolens.jobs.measure_psf import MeasurePsfOutcome, measure_psf
from nolens.jobs.measure_psf_options import MeasurePsfOptions
from nolens.jobs.measure_resolution import (
    ResolutionOutcome,
    measure_edge,
    measure_siemens,
    measure_two_points,
)
from nolens.jobs.measure_resolution_options import EdgeOptions, SiemensOptions, TwoPointOptions
from nolens.jobs.options import Method, ReconstructOptions
from nolens.jobs.psf import PsfOutcome, simulate_psf
from nolens.jobs.reconstruct import Outcome, reconstruct
from nolens.jobs.refocus import RefocusOutcome, refocus
from nolens.jobs.refocus_options import RefocusOptions
from nolens.jobs.relief import ReliefOutcome, replace_relief
from nolens.jobs.relief_options import ReliefOptions
from nolens.jobs.reporter import Reporter
from nolens.jobs.reproduction import ReproduceOptions, ReproduceOutcome, reproduce
from nolens.jobs.scene_options import PsfOptions, SimulateOptions
from nolens.jobs.simulate import SimulationOutcome, simulate
from nolens.jobs.thickness import ThicknessOutcome, design_thickness
from nolens.jobs.thickness_options import ThicknessOptions
from nolens.jobs.tolerance import ToleranceOutcome, study_tolerances, tolerances_text
from nolens.jobs.tolerance_options import ToleranceOptions

__all__ = [
    "CalibrateDistancesOptions",
    "CalibrateDistancesOutcome",
    "CalibratePlanOptions",
    "CalibratePlanOutcome",
    "CalibratePointOptions",
    "CalibratePointOutcome",
    "CalibrateStitchOptions",
    "CalibrateStitchOutcome",
    "CalibrateSurroundOptions",
    "CalibrateSurroundOutcome",
    "DemoResult",
    "EdgeOptions",
    "FabricateOptions",
    "MaskOptions",
    "MaskOutcome",
    "MeasureFieldOptions",
    "MeasureFieldOutcome",
    "MeasurePsfOptions",
    "MeasurePsfOutcome",
    "Method",
    "Outcome",
    "PsfOptions",
    "PsfOutcome",
    "ReconstructOptions",
    "RefocusOptions",
    "RefocusOutcome",
    "ReliefOptions",
    "ReliefOutcome",
    "Reporter",
    "ReproduceOptions",
    "ReproduceOutcome",
    "ResolutionOutcome",
    "SiemensOptions",
    "SimulateOptions",
    "SimulationOutcome",
    "ThicknessOptions",
    "ThicknessOutcome",
    "ToleranceOptions",
    "ToleranceOutcome",
    "TwoPointOptions",
    "calibrate_distances",
    "calibrate_plan",
    "calibrate_point",
    "calibrate_stitch",
    "calibrate_surround",
    "camera_facts",
    "design_mask",
    "design_thickness",
    "expand_home",
    "fabricate",
    "material_facts",
    "measure_edge",
    "measure_field",
    "measure_psf",
    "measure_siemens",
    "measure_two_points",
    "reconstruct",
    "refocus",
    "replace_relief",
    "reproduce",
    "run_demo",
    "simulate",
    "simulate_psf",
    "study_tolerances",
    "tolerances_text",
]
