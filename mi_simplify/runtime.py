"""
Which LLVM Dr.Jit loads, and which Mitsuba variant is active.

Importing this module chooses libLLVM (an environment variable only, nothing is loaded); it never
sets a variant.
"""

from __future__ import annotations

import glob
import os
import sys


def choose_llvm() -> str | None:
    """
    Point Dr.Jit at libLLVM: an explicit ``DRJIT_LIBLLVM_PATH`` wins, then the pip wheel's.
    """
    if "DRJIT_LIBLLVM_PATH" not in os.environ:
        for path in sorted(glob.glob(os.path.join(sys.prefix, "lib", "libLLVM.so.*")), reverse=True)[:1]:
            os.environ["DRJIT_LIBLLVM_PATH"] = path
    return os.environ.get("DRJIT_LIBLLVM_PATH")


choose_llvm()


def ensure_variant(variant: str | None = None) -> str:
    """
    Return the active Mitsuba variant; where there is none, set ``variant`` or ``llvm_ad_rgb``.
    """
    import mitsuba as mi

    if mi.variant() is None:
        mi.set_variant(variant or os.environ.get("MI_SIMPLIFY_VARIANT", "llvm_ad_rgb"))
    return mi.variant()
