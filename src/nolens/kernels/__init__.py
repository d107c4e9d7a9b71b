"""The hot loops: transforms and the fused passes of ADMM, one name each.

Behind every name stands one implementation for the CPU (scipy or ducc0, numba) and one for
CUDA (torch, Triton); callers hand over tensors and never choose.
"""

import lazy_loader

# A Wiener filter needs transforms alone; what compiles takes a third of a second to load.
__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
