"""Compiles every variant of Triton's passes for a GPU that need not be here."""

import itertools
from typing import Any

import triton
from triton.backends.compiler import GPUTarget
from triton.compiler import ASTSource

from nolens.kernels import admm_triton

AMPERE = GPUTarget("cuda", 80, 32)
POINTERS = ("spectrum", "transfer", "penalties", "pair", "out", "data", "measured", "scene",
            "rows", "columns", "constants", "sums")  # fmt: skip


def compile_(kernel: Any, **constants: Any) -> None:
    types = dict.fromkeys(kernel.arg_names, "i32")
    types |= {name: "*fp32" for name in POINTERS if name in types}
    types |= {"valid": "*u8"} if "valid" in types else {}
    types |= dict.fromkeys(constants, "constexpr")
    triton.compile(ASTSource(kernel, types, constants), AMPERE, {"enable_fp_fusion": True})


compile_(admm_triton._solve, BLOCK=512)
for isotropic, absent in itertools.product((False, True), ({}, {"sums": None})):
    for no_tv in ({}, {"rows": None, "columns": None}):
        compile_(admm_triton._update_pixels, ISOTROPIC=isotropic, BLOCK=512, **absent, **no_tv)
    compile_(admm_triton._update_gradient, ISOTROPIC=isotropic, BLOCK=512, **absent)
