"""
Which LLVM Dr.Jit loads, and which Mitsuba variant is active.

Importing this module chooses libLLVM (it sets an environment variable, nothing is loaded) and so
must come before the first import of ``drjit``; it never sets a variant. Dr.Jit's wheel brings no
libLLVM and takes the first that it finds, which may be one that aborts the process.
"""

from __future__ import annotations

import ctypes
import glob
import importlib.abc
import importlib.metadata
import importlib.util
import os
import re
import site
import sys
import sysconfig
from collections.abc import Callable, Iterable
from importlib.machinery import ModuleSpec
from pathlib import Path
from types import ModuleType

from ..errors import RuntimeUnavailable

VARIANTS = ("llvm_ad_rgb", "cuda_ad_rgb")
OLDEST_LLVM = 16  # 15 aborts the process at the first render ("Cannot select: fminimum"), 14 does not load
LLVM_WHEEL = "karellen-llvm-core"

SYSTEM_FOLDERS = (  # glob patterns
    f"/usr/lib/{sysconfig.get_config_var('MULTIARCH') or 'x86_64-linux-gnu'}",
    "/usr/lib64",
    "/usr/lib",
    "/usr/local/lib",
    "/usr/lib/llvm*/lib",
    "/usr/lib64/llvm*/lib*",
    "/opt/homebrew/opt/llvm*/lib",
    "/usr/local/opt/llvm*/lib",
    "C:/Program Files/LLVM/bin",
)

_LIBRARY_NAME = re.compile(r"^(?:lib)?LLVM(?:-C)?(?:-\d+(?:\.\d+)*)?\.(?:so|dylib|dll)(?:\.\d+)*$")


def choose_llvm() -> str | None:
    """
    Point Dr.Jit at a libLLVM that works, through the environment variable ``DRJIT_LIBLLVM_PATH``.

    An explicit ``DRJIT_LIBLLVM_PATH`` wins, then the wheel in this Python environment, then the
    newest system LLVM that is at least version 16.

    Returns
    -------
    str or None
        The library, None where there is no usable one.
    """
    if not os.environ.get("DRJIT_LIBLLVM_PATH"):
        for path in (*_usable(wheel_libraries()), *_usable(system_libraries())):
            os.environ["DRJIT_LIBLLVM_PATH"] = path
            break
    return os.environ.get("DRJIT_LIBLLVM_PATH") or None


def ensure_variant(variant: str | None = None) -> str:
    """
    Return the active Mitsuba variant, after setting ``variant`` where one is named.

    Where none is named and none is active, the environment's ``MI_SIMPLIFY_VARIANT`` is set, else
    ``llvm_ad_rgb``. ``MI_SIMPLIFY_THREADS`` says how many threads compute, where that is not one a core.

    Raises
    ------
    RuntimeUnavailable
        The variant is not one of ``VARIANTS``, there is no usable LLVM, no GPU for CUDA, or no such number of threads.
    """
    active = sys.modules["mitsuba"].variant() if "mitsuba" in sys.modules else None
    wanted = variant or active or os.environ.get("MI_SIMPLIFY_VARIANT") or VARIANTS[0]
    if wanted not in VARIANTS:
        raise RuntimeUnavailable(f"variant '{wanted}' is not supported; use one of {', '.join(VARIANTS)}")
    if wanted.startswith("llvm"):
        _require_llvm()  # before the import below, which loads it
    try:
        import mitsuba as mi
    except ImportError as error:
        way_out = "pip install 'mitsuba>=3.9,<3.10'"
        raise RuntimeUnavailable(f"Mitsuba cannot be imported ({error}); install it: {way_out}") from None
    if wanted.startswith("cuda"):
        require_cuda()
    if wanted != active:
        mi.set_variant(wanted)
        _limit_threads(os.environ.get("MI_SIMPLIFY_THREADS", ""))
    return wanted


def _limit_threads(text: str) -> None:
    """The threads of Dr.Jit, and so of Mitsuba; sums of one thread are the same to the bit every time."""
    import drjit as dr

    if not text:
        return
    if not re.fullmatch(r"0*[1-9]\d{0,3}", text):
        raise RuntimeUnavailable(f"MI_SIMPLIFY_THREADS is '{text}'; set it to a number from 1 on, or unset it")
    dr.set_thread_count(int(text))


def require_cuda() -> None:
    """
    Raise :class:`RuntimeUnavailable` unless there is a GPU; Mitsuba's own error would be obscure.
    """
    import drjit as dr

    if not dr.has_backend(dr.JitBackend.CUDA):
        raise RuntimeUnavailable(
            "variant 'cuda_ad_rgb' needs an NVIDIA GPU and its driver, and none was found; use --variant llvm_ad_rgb"
        )


def wheel_libraries() -> list[str]:
    """
    libLLVM files that pip or conda put into this environment or the user's, best first.
    """
    folders = [sysconfig.get_path("data"), sys.prefix, site.getuserbase()]
    found = [path for folder in dict.fromkeys(folders) for path in _libraries(os.path.join(folder, "lib"))]
    if not _usable(found):  # installed somewhere else on sys.path, as by `pip install --target`
        try:
            records = importlib.metadata.files(LLVM_WHEEL) or []
        except importlib.metadata.PackageNotFoundError:
            records = []
        found += [os.path.realpath(f.locate()) for f in records if _LIBRARY_NAME.match(f.name)]
    return found


def system_libraries() -> list[str]:
    """
    libLLVM files of the operating system, newest first.
    """
    patterns = (*os.environ.get("LD_LIBRARY_PATH", "").split(os.pathsep), *SYSTEM_FOLDERS)
    found = [path for pattern in patterns if pattern for folder in glob.glob(pattern) for path in _libraries(folder)]
    return sorted(dict.fromkeys(found), key=lambda path: llvm_version(path) or 0, reverse=True)


def llvm_version(path: str) -> int | None:
    """
    Major version of a libLLVM: by its name, else by asking it; None where it cannot be loaded.
    """
    for name in (path, os.path.realpath(path)):
        match = re.search(r"LLVM(?:-C)?(?:-|\.so\.|\.)(\d+)", os.path.basename(name))
        if match:
            return int(match[1])
    return loaded_version(path)


def loaded_version(path: str) -> int | None:
    """
    Major version of a libLLVM by loading it, 15 for anything older than 16; None where that fails.
    """
    try:
        library = ctypes.CDLL(path)
    except OSError:
        return None
    if not hasattr(library, "LLVMGetVersion"):  # new in 16
        return OLDEST_LLVM - 1
    major = ctypes.c_uint()
    library.LLVMGetVersion(ctypes.byref(major), None, None)
    return major.value


def after_import(name: str, callback: Callable[[], None]) -> None:
    """
    Call ``callback`` once a module has been imported: now, or when somebody imports it.

    So our plugins are there for everyone who imports Mitsuba after us, and importing us stays
    cheap for everyone who does not.
    """
    if name in sys.modules:
        callback()
    else:
        sys.meta_path.insert(0, _AfterImport(name, callback))


class _AfterImport(importlib.abc.MetaPathFinder):
    """Finds one module by the usual means and makes its loader call back at the end."""

    def __init__(self, name: str, callback: Callable[[], None]):
        self.name, self.callback = name, callback

    def find_spec(self, fullname: str, path: object = None, target: object = None) -> ModuleSpec | None:
        if fullname != self.name:
            return None
        sys.meta_path.remove(self)
        spec = importlib.util.find_spec(fullname)
        if spec is not None and spec.loader is not None:
            execute = spec.loader.exec_module

            def exec_module(module: ModuleType) -> None:
                execute(module)
                self.callback()

            spec.loader.exec_module = exec_module  # type: ignore[method-assign]
        return spec


def _libraries(folder: str) -> list[str]:
    """Files of a folder that are named like a libLLVM, newest first; links to one file count once."""
    named = glob.glob(os.path.join(glob.escape(folder), "*LLVM*"))
    paths = {os.path.realpath(p) for p in named if _LIBRARY_NAME.match(os.path.basename(p))}
    return sorted(paths, key=lambda p: llvm_version(p) or 0, reverse=True)


def _usable(paths: Iterable[str]) -> list[str]:
    return [path for path in paths if (llvm_version(path) or 0) >= OLDEST_LLVM]


def _require_llvm() -> None:
    """Raise unless Dr.Jit has loaded, or will load, an LLVM that can render."""
    way_out = f"install one with 'pip install {LLVM_WHEEL}', or let DRJIT_LIBLLVM_PATH name one"
    if "drjit" in sys.modules:  # which loads it on import
        name, version = "the LLVM that Dr.Jit loaded", sys.modules["drjit"].detail.llvm_version()[0]
        way_out = f"import mi_simplify before drjit and mitsuba; {way_out}"
        if version < 0:
            raise RuntimeUnavailable(f"Dr.Jit found no libLLVM when it was imported; {way_out}")
    else:
        path = choose_llvm()
        if path is None:
            too_old = [*wheel_libraries(), *system_libraries()][:1]
            found = f" (found {too_old[0]}, which is too old)" if too_old else ""
            raise RuntimeUnavailable(f"no libLLVM of version {OLDEST_LLVM} or newer{found}; {way_out}")
        if not Path(path).is_file():
            raise RuntimeUnavailable(f"DRJIT_LIBLLVM_PATH is '{path}', which is no file; unset it, or {way_out}")
        name, version = path, llvm_version(path)
        if version is None or version >= OLDEST_LLVM:  # a name may promise too much
            version = loaded_version(path)
        if version is None:
            raise RuntimeUnavailable(f"'{path}' cannot be loaded as libLLVM; unset DRJIT_LIBLLVM_PATH, or {way_out}")
    if version < OLDEST_LLVM:
        raise RuntimeUnavailable(
            f"{name} is version {version}, which aborts while rendering; {OLDEST_LLVM} or newer is needed: {way_out}"
        )


choose_llvm()
