from . import (
    calibrate,
    capture,
    design,
    evaluate,
    fabricate,
    operators,
    optics,
    refocusing,
    solvers,
    twin,
)
from .api.calibrate import (
    CalibratedPsf,
    ImportedPsf,
    StitchedPsf,
    calibrate_psf,
    import_psf,
    stitch_psfs,
)
from .api.dataset import LenslessDataset
from .api.design import ThicknessDesign, design_mask, design_thickness
from .api.image import Image
from .api.inputs import load, save_frame
from .api.measure import (
    FieldOfView,
    Resolution,
    compare,
    measure_field,
    measure_psf,
    measure_resolution,
    psnr,
    ssim,
)
from .api.reconstruct import Photograph, reconstruct, refocus
from .api.simulate import Camera, Psf, SimulatedMeasurement, psf, simulate, simulate_point
from .api.stacks import (
    Cube,
    Stack,
    Video,
    Volume,
    reconstruct_cube,
    reconstruct_video,
    reconstruct_volume,
)
from .camera import Frame, Measurement, develop
from .operators import PixelRectangle
from .solvers import Prior, Problem, Reconstructor

__all__ = [
    "CalibratedPsf",
    "Camera",
    "Cube",
    "FieldOfView",
    "Frame",
    "Image",
    "ImportedPsf",
    "LenslessDataset",
    "Measurement",
    "Photograph",
    "PixelRectangle",
    "Prior",
    "Problem",
    "Psf",
    "Reconstructor",
    "Resolution",
    "SimulatedMeasurement",
    "Stack",
    "StitchedPsf",
    "ThicknessDesign",
    "Video",
    "Volume",
    "calibrate",
    "calibrate_psf",
    "capture",
    "compare",
    "design",
    "design_mask",
    "design_thickness",
    "develop",
    "evaluate",
    "fabricate",
    "import_psf",
    "load",
    "measure_field",
    "measure_psf",
    "measure_resolution",
    "operators",
    "optics",
    "psf",
    "psnr",
    "reconstruct",
    "reconstruct_cube",
    "reconstruct_video",
    "reconstruct_volume",
    "refocus",
    "refocusing",
    "save_frame",
    "simulate",
    "simulate_point",
    "solvers",
    "ssim",
    "stitch_psfs",
    "twin",
]

__version__: str
