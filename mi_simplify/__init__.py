"""
Appearance-driven simplification of 3D models on Mitsuba 3 and Dr.Jit.
"""

from .runtime import choose_llvm as choose_llvm

__version__ = "0.1.0"
