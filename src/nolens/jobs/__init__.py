"""Whole jobs, from files to files: what the command line runs, and programs can call."""

import lazy_loader

# A command loads only what it uses: all of it would take seconds.
__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
