"""
Registers our Mitsuba plugins, once this module is imported, with the active variant and after every change of it.
"""

from __future__ import annotations

import importlib
import sys

import mitsuba as mi

from .errors import RuntimeUnavailable

#: Modules that define a plugin class and register it on their last line.
MODULES = (
    "mi_simplify.bsdfs.mapped_texture",
    "mi_simplify.bsdfs.ggx_gamma",
    "mi_simplify.integrators.direct_edge",
    "mi_simplify.integrators.lights.own_light",
    "mi_simplify.integrators.lights.direct_views",
)

#: Variants in which they work: gradients and RGB.
VARIANTS = ("llvm_ad_rgb", "cuda_ad_rgb")


def _register(_old: str | None, new: str | None) -> None:
    """
    Import the plugin modules, again where they were bound to another variant's classes.

    In variants that cannot run them their names stay taken, by an error that says which ones can.
    """
    if new is None:
        return
    if new not in VARIANTS:
        mi.register_bsdf("ggx_gamma", _refuse)
        mi.register_texture("mapped_texture", _refuse)
        mi.register_integrator("direct_edge", _refuse)
        mi.register_integrator("own_light", _refuse)
        mi.register_integrator("direct_views", _refuse)
        return
    for name in MODULES:
        if name in sys.modules:
            importlib.reload(sys.modules[name])
        else:
            importlib.import_module(name)


def _refuse(_props: mi.Properties) -> None:
    require_ad_variant()


def require_ad_variant() -> None:
    """
    Raise where the active variant has no gradients or is not RGB.
    """
    if mi.variant() not in VARIANTS:
        raise RuntimeUnavailable(f"variant '{mi.variant()}' cannot be used: choose one of {', '.join(VARIANTS)}")


mi.detail.add_variant_callback(_register)
if mi.variant() is not None:
    _register(None, mi.variant())
