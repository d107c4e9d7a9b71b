"""Simulated cameras: from a mask's surface to the counts of the sensor.

What stands here serves `nolens demo`: a random-lenslet mask in one homogeneous medium and a
measurement by plain convolution.
"""

from nolens.twin.caustic import LensletMask, caustic_psf
from nolens.twin.sensor import Sensor, expose

__all__ = ["LensletMask", "Sensor", "caustic_psf", "expose"]
