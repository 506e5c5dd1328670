"""
NumPy arrays into Dr.Jit's own memory.
"""

from __future__ import annotations

import drjit as dr
import mitsuba as mi
import numpy as np


def upload(kind: type, array: np.ndarray):
    """
    A Dr.Jit array with a copy of NumPy data.

    ``kind(array)`` alone borrows the memory on the CPU: a kernel that still waits in the queue when the last Python
    reference goes reads freed memory, and wide gathers and scatters may crash because it is not aligned.

    Parameters
    ----------
    kind : type
        Such as ``mi.Float`` for shape (N,), ``mi.Vector4f`` for shape (N, 4).
    array : ndarray
        Converted to the kind's own scalar type; rows are entries.

    Notes
    -----
    Waits for the device.
    """
    t = dr.VarType
    scalars = {t.Float32: np.float32, t.Float16: np.float16, t.UInt32: np.uint32, t.Int32: np.int32, t.Bool: np.bool_}
    scalar = scalars[dr.type_v(kind)]
    borrowed = kind(np.ascontiguousarray(np.asarray(array).T, dtype=scalar))
    copied = dr.select(dr.opaque(mi.Bool, True), borrowed, dr.zeros(kind))
    dr.eval(copied)
    dr.sync_thread()
    return copied
