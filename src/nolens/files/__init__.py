"""Every read and write of a file: camera raw, TIFF, PNG, npy, DNG and run records.

`read_frame` reads what a camera wrote into a `nolens.camera.Frame`, whatever its format; the
writers make pictures, linear TIFFs, DNGs and the record of a run, each by way of a temporary
file, so that a killed run leaves no half file. All that goes wrong is a `FileError` that says
what was found and what would be accepted.
"""

import lazy_loader

# A command loads only what it uses: all of it would take seconds.
__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
