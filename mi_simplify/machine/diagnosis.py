"""
What is installed, which LLVM, does a kernel run: the checks behind ``mi-simplify doctor``.
"""

from __future__ import annotations

import importlib.metadata
import os
import platform
import re
import signal
import subprocess
import sys
import time
from dataclasses import dataclass

from packaging.requirements import Requirement

from . import runtime

# A render with its gradient, as small as it gets, in a process of its own: a bad LLVM aborts it.
_KERNEL = """
import sys
from mi_simplify.machine import runtime
runtime.ensure_variant(sys.argv[1])
import drjit as dr, mitsuba as mi
scene = mi.load_dict({"type": "scene", "shape": {"type": "sphere"}, "light": {"type": "point", "position": [0, 0, 3]},
    "sensor": {"type": "perspective", "to_world": mi.ScalarTransform4f().look_at([0, 0, 4], [0, 0, 0], [0, 1, 0]),
    "film": {"type": "hdrfilm", "width": 8, "height": 8}}, "integrator": {"type": "direct"}})
params = mi.traverse(scene)
key = "shape.bsdf.reflectance.value"
dr.enable_grad(params[key])
params.update()
dr.backward(dr.sum(mi.render(scene, params, spp=4), axis=None))
value = dr.max(dr.grad(params[key]), axis=None)
sys.exit(0 if dr.isfinite(value)[0] and value[0] > 0 else "the gradient is wrong")
"""


@dataclass(frozen=True)
class Check:
    """
    One line of the diagnosis.

    Parameters
    ----------
    name : str
    ok : bool
    detail : str
        Version, path or figure; where ``ok`` is False, what is wrong and the way out.
    required : bool
        Whether anything runs without it; a missing GPU, for one, is no fault.
    """

    name: str
    ok: bool
    detail: str
    required: bool = True


def doctor(variant: str | None = None) -> list[Check]:
    """
    Examine this installation; nothing is raised and the active variant stays as it is.

    Parameters
    ----------
    variant : str or None
        The variant that the test kernel runs in; None as in :func:`mi_simplify.machine.runtime.ensure_variant`.
    """
    return [_python(), *_packages(), _llvm(), _cuda(), _cores(), _memory(), _kernel(variant)]


def _python() -> Check:
    version = platform.python_version()
    return Check("python", sys.version_info >= (3, 11), f"{version} ({platform.platform()})")


def _packages() -> list[Check]:
    """The package's own requirements, as its metadata states them."""
    try:
        requirements = [Requirement(text) for text in importlib.metadata.requires("mi-simplify") or []]
    except importlib.metadata.PackageNotFoundError:
        return [Check("mi-simplify", False, "not installed, so its requirements are unknown; run: pip install -e .")]
    checks = []
    for requirement in requirements:
        if requirement.marker is not None and not requirement.marker.evaluate({"extra": ""}):
            continue
        try:
            version = importlib.metadata.version(requirement.name)
        except importlib.metadata.PackageNotFoundError:
            checks.append(Check(requirement.name, False, f"missing; run: pip install '{requirement}'"))
            continue
        fits = requirement.specifier.contains(version, prereleases=True)
        problem = "" if fits else f", but {requirement.specifier} is needed; run: pip install '{requirement}'"
        checks.append(Check(requirement.name, fits, version + problem))
    return checks


def _llvm() -> Check:
    path = runtime.choose_llvm()
    if path is None:
        return Check("libLLVM", False, f"no usable one; run: pip install {runtime.LLVM_WHEEL}")
    version = runtime.llvm_version(path)
    if version is None or runtime.loaded_version(path) is None:
        return Check("libLLVM", False, f"{path} cannot be loaded; unset DRJIT_LIBLLVM_PATH or let it name another")
    if version < runtime.OLDEST_LLVM:
        return Check("libLLVM", False, f"{version} at {path}, {runtime.OLDEST_LLVM} or newer is needed")
    return Check("libLLVM", True, f"{version} at {path}")


def _cuda() -> Check:
    try:
        runtime.require_cuda()
    except (runtime.RuntimeUnavailable, ImportError):
        return Check("cuda_ad_rgb", False, "no NVIDIA GPU found; llvm_ad_rgb does not need one", required=False)
    return Check("cuda_ad_rgb", True, "an NVIDIA GPU was found", required=False)


def _cores() -> Check:
    affinity = getattr(os, "sched_getaffinity", None)
    return Check("cores", True, str(len(affinity(0)) if affinity else os.cpu_count()))


def _memory() -> Check:
    try:
        total = os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE")
    except (AttributeError, ValueError, OSError):
        return Check("memory", True, "unknown", required=False)
    return Check("memory", total >= 2 << 30, f"{total / (1 << 30):.1f} GiB")


def _kernel(variant: str | None, timeout: float = 120.0) -> Check:
    """Render in a process of its own, so that an abort there is a finding here."""
    import mitsuba as mi

    wanted = variant or mi.variant() or os.environ.get("MI_SIMPLIFY_VARIANT") or runtime.VARIANTS[0]
    name = f"kernel ({wanted})"
    start = time.perf_counter()
    try:
        done = subprocess.run(
            [sys.executable, "-c", _KERNEL, wanted], capture_output=True, text=True, timeout=timeout, check=False
        )
    except subprocess.TimeoutExpired:
        return Check(name, False, f"did not finish within {timeout:.0f} s")
    if done.returncode == 0:
        return Check(name, True, f"rendered with its gradient in {time.perf_counter() - start:.1f} s")
    lines = [line for line in done.stderr.splitlines() if line.strip()]
    reason = re.sub(r"^[\w.]+(Error|Unavailable): ", "", lines[-1]) if lines else f"exit code {done.returncode}"
    if done.returncode < 0:
        ended_by = signal.Signals(-done.returncode).name
        reason = f"the process was ended by {ended_by}: {lines[0] if lines else 'no message'}"
    return Check(name, False, reason)
