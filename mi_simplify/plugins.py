"""
Registers our Mitsuba plugins, once this module is imported, with the active variant and after every change of it.
"""

from __future__ import annotations

import importlib
import sys

import mitsuba as mi

from .errors import RuntimeUnavailable

#: Variants that all of them work in, the fit's: gradients and RGB.
RGB_VARIANTS = ("llvm_ad_rgb", "cuda_ad_rgb")

#: Variants that those of any scene work in: gradients, and colours of one number, three, or at drawn wavelengths.
VARIANTS = (*RGB_VARIANTS, "llvm_ad_mono", "cuda_ad_mono", "llvm_ad_spectral", "cuda_ad_spectral")

#: Modules that define a plugin class and register it on their last line: the kind of plugin, its name, its variants.
MODULES = {
    "mi_simplify.bsdfs.mapped_texture": ("texture", "mapped_texture", VARIANTS),
    "mi_simplify.bsdfs.ggx_gamma": ("bsdf", "ggx_gamma", VARIANTS),
    "mi_simplify.integrators.direct_edge": ("integrator", "direct_edge", VARIANTS),
    "mi_simplify.integrators.soft.plugin": ("integrator", "hard_soft", RGB_VARIANTS),
    "mi_simplify.integrators.lights.own_light": ("integrator", "own_light", RGB_VARIANTS),
    "mi_simplify.integrators.lights.direct_views": ("integrator", "direct_views", RGB_VARIANTS),
}


def _register(_old: str | None, new: str | None) -> None:
    """
    Import the plugin modules, again where they were bound to another variant's classes.

    In variants that cannot run them their names stay taken, by an error that says which ones can.
    """
    if new is None:
        return
    for module, (kind, name, variants) in MODULES.items():
        if new not in variants:
            getattr(mi, f"register_{kind}")(name, lambda _, allowed=variants: require_variant(allowed))
        elif module in sys.modules:
            importlib.reload(sys.modules[module])
        else:
            importlib.import_module(module)


def require_variant(allowed: tuple[str, ...]) -> None:
    """
    Raise where the active variant is none of those allowed.
    """
    if mi.variant() not in allowed:
        raise RuntimeUnavailable(f"variant '{mi.variant()}' cannot be used: choose one of {', '.join(allowed)}")


mi.detail.add_variant_callback(_register)
if mi.variant() is not None:
    _register(None, mi.variant())
