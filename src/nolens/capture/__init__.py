"""Cameras that frames come from: a Raspberry Pi's, a simulated one, or a folder of raw files.

`open_source` gives any of them by its text, such as ``"auto"`` or ``"twin:live"``. All have the
same four steps: open, set, shot, close (`CameraSource`). Another one is a module of its own and a
line in the table of `source.py`.
"""

import lazy_loader

# Who lists the sources does not need what simulates or reads files: that takes seconds.
__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
