"""
Appearance-driven simplification of 3D models on Mitsuba 3 and Dr.Jit.

Importing this package chooses the libLLVM that Dr.Jit will load and sets no variant. Everything
below is imported when it is first used; our Mitsuba plugins register themselves with every
variant that anyone sets::

    import mi_simplify as ms

    config = ms.load_config(overrides=["asset=statue.obj", "initial.triangles=2000"])
    result = ms.run_job(config, "out/statue")
"""

from __future__ import annotations

import importlib
from typing import Any

from .machine.runtime import after_import as _after_import
from .machine.runtime import choose_llvm as choose_llvm
from .machine.runtime import ensure_variant as ensure_variant

__version__ = "0.2.0"

_EXPORTS = {
    "Asset": "model.asset",
    "Config": "config",
    "FitSettings": "config",
    "Frame": "model.frame",
    "InitialSettings": "config",
    "Model": "model.model",
    "UserError": "errors",
    "bake": "initial.bake.baker",
    "doctor": "machine.diagnosis",
    "dump": "config",
    "evaluate": "judging",
    "export_model": "export",
    "decimated": "initial.guess",
    "first_guess": "initial.guess",
    "from_mesh": "initial.guess",
    "inflated": "initial.guess",
    "on_cards": "initial.guess",
    "fit": "fitting",
    "load_asset": "formats.load",
    "load_config": "config",
    "make_reference": "scenes.references.path_traced",
    "Optimization": "jobs.optimization",
    "open_asset": "subjects",
    "register_loss": "fitting.losses",
    "register_operation": "latent.operation",
    "register_reader": "formats.load",
    "register_subject": "subjects.registry",
    "register_writer": "export",
    "report_folder": "report",
    "run_job": "jobs.job",
}

__all__ = ["choose_llvm", "ensure_variant", *_EXPORTS]


def __getattr__(name: str) -> Any:
    """
    Import what ``_EXPORTS`` names on first use.
    """
    if name not in _EXPORTS:
        raise AttributeError(f"module 'mi_simplify' has no attribute '{name}'")
    value = getattr(importlib.import_module(f".{_EXPORTS[name]}", __name__), name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted([*globals(), *_EXPORTS])


def _install_plugins() -> None:
    importlib.import_module(".plugins", __name__)  # registers itself


_after_import("mitsuba", _install_plugins)
