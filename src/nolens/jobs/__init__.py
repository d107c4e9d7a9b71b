"""Whole jobs, from files to files: what the command line runs, and programs can call."""

from nolens.jobs.calibration.distances import CalibrateDistancesOutcome, calibrate_distances
from nolens.jobs.calibration.distances_options import CalibrateDistancesOptions
from nolens.jobs.calibration.folder import CalibratedPsf
from nolens.jobs.calibration.pairs import calibrate_pairs
from nolens.jobs.calibration.pairs_options import CalibratePairsOptions
from nolens.jobs.calibration.plan import CalibratePlanOutcome, calibrate_plan
from nolens.jobs.calibration.point import calibrate_point
from nolens.jobs.calibration.point_options import CalibratePointOptions
from nolens.jobs.calibration.stitch import calibrate_stitch
from nolens.jobs.calibration.stitch_options import CalibratePlanOptions, CalibrateStitchOptions
from nolens.jobs.calibration.surround import calibrate_surround
from nolens.jobs.calibration.surround_options import CalibrateSurroundOptions
from nolens.jobs.camera_facts import camera_facts
from nolens.jobs.demo import DemoResult, run_demo
from nolens.jobs.designing.mask import MaskOutcome, design_mask
from nolens.jobs.designing.mask_options import MaskOptions
from nolens.jobs.designing.thickness import ThicknessOutcome, design_thickness
from nolens.jobs.designing.thickness_options import ThicknessOptions
from nolens.jobs.designing.tolerance import ToleranceOutcome, study_tolerances, tolerances_text
from nolens.jobs.designing.tolerance_options import ToleranceOptions
from nolens.jobs.fabrication.fabricate import fabricate
from nolens.jobs.fabrication.options import FabricateOptions
from nolens.jobs.given import expand_home
from nolens.jobs.material_facts import material_facts
from nolens.jobs.measuring.field import MeasureFieldOutcome, measure_field
from nolens.jobs.measuring.field_options import MeasureFieldOptions
from nolens.jobs.measuring.psf import MeasurePsfOutcome, measure_psf
from nolens.jobs.measuring.psf_options import MeasurePsfOptions
from nolens.jobs.measuring.resolution import (
    ResolutionOutcome,
    measure_edge,
    measure_siemens,
    measure_two_points,
)
from nolens.jobs.measuring.resolution_options import EdgeOptions, SiemensOptions, TwoPointOptions
from nolens.jobs.psf import PsfOutcome, simulate_psf
from nolens.jobs.reconstruction.job import Outcome, reconstruct
from nolens.jobs.reconstruction.options import Method, ReconstructOptions
from nolens.jobs.refocusing.options import RefocusOptions
from nolens.jobs.refocusing.refocus import RefocusOutcome, refocus
from nolens.jobs.relief import ReliefOutcome, replace_relief
from nolens.jobs.relief_options import ReliefOptions
from nolens.jobs.reporter import Reporter
from nolens.jobs.reproduction import ReproduceOptions, ReproduceOutcome, reproduce
from nolens.jobs.scene_options import PsfOptions, SimulateOptions
from nolens.jobs.simulate import SimulationOutcome, simulate

__all__ = [
    "CalibrateDistancesOptions",
    "CalibrateDistancesOutcome",
    "CalibratePairsOptions",
    "CalibratePlanOptions",
    "CalibratePlanOutcome",
    "CalibratePointOptions",
    "CalibrateStitchOptions",
    "CalibrateSurroundOptions",
    "CalibratedPsf",
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
    "calibrate_pairs",
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
