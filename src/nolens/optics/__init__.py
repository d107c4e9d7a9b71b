"""Optics of plane layers under a relief: rays, waves, and the PSF."""

import lazy_loader

# Random lenslets are laid out by compiled code, which takes a third of a second to load.
__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
