from .batch.each import batch_each, batch_options
from .batch.reconstruction import BatchReconstructOptions, batch_reconstruct
from .calibration.distances import CalibrateDistancesOptions, calibrate_distances
from .calibration.extrapolate import CalibrateExtrapolateOptions, calibrate_extrapolate
from .calibration.import_psfs import CalibrateImportOptions, calibrate_import
from .calibration.pairs import CalibratePairsOptions, calibrate_pairs
from .calibration.point import CalibratePointOptions, calibrate_point
from .calibration.stitch import (
    CalibratePlanOptions,
    CalibrateStitchOptions,
    calibrate_plan,
    calibrate_stitch,
)
from .capturing import CaptureOptions, CaptureReporter, capture_frames
from .collecting import CollectOptions, CollectReporter, collect
from .comparing import Compared, CompareOptions, compare
from .dataset.job import make_dataset
from .dataset.options import DatasetOptions
from .demo import DemoOptions, run_demo
from .designing.look import look_at_design
from .designing.mask import MASK_KINDS, MaskOptions, design_mask
from .designing.thickness import ThicknessOptions, design_thickness
from .designing.tolerance import ToleranceOptions, study_tolerances
from .fabrication import FabricateOptions, fabricate
from .measuring.edge import EdgeOptions, measure_edge
from .measuring.field import MeasureFieldOptions, measure_field
from .measuring.psf import MeasurePsfOptions, measure_psf
from .measuring.siemens import SiemensOptions, measure_siemens
from .measuring.target import TargetOptions, make_target
from .measuring.two_points import TwoPointOptions, measure_two_points
from .options import expand_home
from .preview import write_preview
from .psf import PsfOptions, simulate_psf
from .reconstruction.job import reconstruct
from .reconstruction.options import ReconstructOptions
from .refocusing import Refocused, RefocusOptions, refocus
from .relief import ReliefOptions, replace_relief
from .run import Reporter, Result
from .simulation import SimulateOptions, simulate
from .training.job import train
from .training.options import TrainOptions

__all__ = [
    "MASK_KINDS",
    "BatchReconstructOptions",
    "CalibrateDistancesOptions",
    "CalibrateExtrapolateOptions",
    "CalibrateImportOptions",
    "CalibratePairsOptions",
    "CalibratePlanOptions",
    "CalibratePointOptions",
    "CalibrateStitchOptions",
    "CaptureOptions",
    "CaptureReporter",
    "CollectOptions",
    "CollectReporter",
    "CompareOptions",
    "Compared",
    "DatasetOptions",
    "DemoOptions",
    "EdgeOptions",
    "FabricateOptions",
    "MaskOptions",
    "MeasureFieldOptions",
    "MeasurePsfOptions",
    "PsfOptions",
    "ReconstructOptions",
    "RefocusOptions",
    "Refocused",
    "ReliefOptions",
    "Reporter",
    "Result",
    "SiemensOptions",
    "SimulateOptions",
    "TargetOptions",
    "ThicknessOptions",
    "ToleranceOptions",
    "TrainOptions",
    "TwoPointOptions",
    "batch_each",
    "batch_options",
    "batch_reconstruct",
    "calibrate_distances",
    "calibrate_extrapolate",
    "calibrate_import",
    "calibrate_pairs",
    "calibrate_plan",
    "calibrate_point",
    "calibrate_stitch",
    "capture_frames",
    "collect",
    "compare",
    "design_mask",
    "design_thickness",
    "expand_home",
    "fabricate",
    "look_at_design",
    "make_dataset",
    "make_target",
    "measure_edge",
    "measure_field",
    "measure_psf",
    "measure_siemens",
    "measure_two_points",
    "reconstruct",
    "refocus",
    "replace_relief",
    "run_demo",
    "simulate",
    "simulate_psf",
    "study_tolerances",
    "train",
    "write_preview",
]
