"""A toolchain for lensless cameras: from a raw measurement and a PSF to the photograph."""

from importlib.metadata import version

__version__ = version("nolens")
