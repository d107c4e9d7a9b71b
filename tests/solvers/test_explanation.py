"""What is said of a PSF and a measurement that do not belong together, and that good ones are silent."""
