"""How good a picture is against the truth, and figures of PSFs and of pictures of targets."""

import lazy_loader

# A command loads only what it uses: targets bring parts of scipy with them.
__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
