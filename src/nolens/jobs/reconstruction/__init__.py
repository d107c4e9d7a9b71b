"""From measurements and a PSF to pictures."""
