"""Choosing libLLVM and a variant: fake folders for the choice, processes of their own for what must not leak."""

import importlib.metadata
import os
import subprocess
import sys
from pathlib import Path

import pytest

from mi_simplify.errors import RuntimeUnavailable
from mi_simplify.machine import runtime
from mi_simplify.machine.diagnosis import doctor


def run_python(program: str, **environment: str) -> subprocess.CompletedProcess:
    """A fresh interpreter without our choice of LLVM in its environment."""
    env = {k: v for k, v in os.environ.items() if k not in ("DRJIT_LIBLLVM_PATH", "MI_SIMPLIFY_VARIANT")}
    return subprocess.run(
        [sys.executable, "-c", program], env=env | environment, capture_output=True, text=True, timeout=120, check=False
    )


def library(folder: Path, name: str) -> str:
    folder.mkdir(parents=True, exist_ok=True)
    (folder / name).write_bytes(b"")
    return str((folder / name).resolve())


@pytest.fixture
def machine(tmp_path, monkeypatch):
    """An empty machine: a prefix, a system folder, no explicit choice."""
    prefix, system = tmp_path / "prefix", tmp_path / "system"
    monkeypatch.delenv("DRJIT_LIBLLVM_PATH")
    monkeypatch.delenv("LD_LIBRARY_PATH", raising=False)
    monkeypatch.setattr(runtime.sysconfig, "get_path", lambda name, *a, **k: str(prefix))
    monkeypatch.setattr(runtime.sys, "prefix", str(prefix))
    monkeypatch.setattr(runtime.site, "getuserbase", lambda: str(tmp_path / "user"))
    monkeypatch.setattr(runtime, "SYSTEM_FOLDERS", (str(system), f"{system}/llvm-*/lib"))
    monkeypatch.setattr(runtime.importlib.metadata, "files", lambda name: [])
    return tmp_path


@pytest.mark.parametrize(
    ("name", "version"),
    [
        ("libLLVM-14.0.6.so.1", 14),
        ("libLLVM-15.so.1", 15),
        ("libLLVM-15.so", 15),
        ("libLLVM.so.19.1", 19),
        ("libLLVM.so.23.1", 23),
        ("libLLVM.20.dylib", 20),
    ],
)
def test_the_version_is_read_from_the_name(tmp_path, name, version):
    assert runtime.llvm_version(library(tmp_path, name)) == version


def test_a_name_without_a_version_is_resolved_or_asked(tmp_path):
    library(tmp_path, "libLLVM-17.so.1")
    (tmp_path / "libLLVM.so").symlink_to("libLLVM-17.so.1")
    assert runtime.llvm_version(str(tmp_path / "libLLVM.so")) == 17
    assert runtime.llvm_version(library(tmp_path / "fake", "libLLVM.so")) is None  # no library at all


def test_the_wheel_wins_over_a_newer_system_llvm(machine):
    wheel = library(machine / "prefix/lib", "libLLVM.so.23.1")
    library(machine / "system", "libLLVM-99.so.1")
    assert runtime.choose_llvm() == wheel == os.environ["DRJIT_LIBLLVM_PATH"]


def test_the_user_site_and_target_folders_are_searched(machine, monkeypatch):
    class Record(importlib.metadata.PackagePath):
        def locate(self):
            return machine / "target" / self

    in_target = library(machine / "target/lib", "libLLVM.so.22.1")
    records = [Record("include/llvm.h"), Record("lib/libLLVM.so.22.1")]
    monkeypatch.setattr(runtime.importlib.metadata, "files", lambda name: records)
    assert runtime.wheel_libraries() == [in_target]
    in_user = library(machine / "user/lib", "libLLVM.so.23.1")
    assert runtime.wheel_libraries() == [in_user]


def test_the_newest_system_llvm_is_taken_and_never_one_below_16(machine):
    library(machine / "system", "libLLVM-15.so.1")
    library(machine / "system", "libLLVM-14.so.1")
    assert runtime.choose_llvm() is None
    assert "DRJIT_LIBLLVM_PATH" not in os.environ
    library(machine / "system/llvm-16/lib", "libLLVM-16.so.1")
    newest = library(machine / "system/llvm-19/lib", "libLLVM.so.19.1")
    library(machine / "system", "libLLVMSupport.so.99")  # a component, not the library
    assert runtime.choose_llvm() == newest


def test_an_explicit_choice_wins(machine, monkeypatch):
    library(machine / "prefix/lib", "libLLVM.so.23.1")
    monkeypatch.setenv("DRJIT_LIBLLVM_PATH", "/somewhere/libLLVM.so.18.1")
    assert runtime.choose_llvm() == "/somewhere/libLLVM.so.18.1"


def test_without_a_usable_llvm_the_message_says_what_to_install(machine, monkeypatch):
    library(machine / "system", "libLLVM-15.so.1")
    monkeypatch.delitem(sys.modules, "drjit")
    with pytest.raises(RuntimeUnavailable, match=r"16 or newer \(found .*LLVM-15.so.1.*pip install karellen-llvm-core"):
        runtime._require_llvm()


@pytest.mark.parametrize(
    ("name", "message"),
    [("libLLVM-15.so.1", "is version 15, which aborts"), ("libLLVM.so.18.1", "cannot be loaded"), (None, "is no file")],
)
def test_an_explicit_choice_that_cannot_render_is_refused(tmp_path, name, message):
    path = library(tmp_path, name) if name else str(tmp_path / "missing.so")
    script = "from mi_simplify.machine.runtime import ensure_variant; ensure_variant()"
    done = run_python(script, DRJIT_LIBLLVM_PATH=path)
    assert done.returncode == 1
    assert "jit_" not in done.stderr  # Dr.Jit was not asked
    assert done.stderr.splitlines()[-1].startswith("mi_simplify.errors.RuntimeUnavailable: ")
    assert message in done.stderr.splitlines()[-1]


def test_importing_us_chooses_llvm_and_loads_nothing():
    done = run_python(
        "import os, sys, mi_simplify\n"
        "print('drjit' in sys.modules, 'mitsuba' in sys.modules, 'numpy' in sys.modules)\n"
        "import mitsuba as mi\n"
        "print(mi.variant(), os.path.isfile(os.environ['DRJIT_LIBLLVM_PATH']))"
    )
    assert done.stdout.split("\n")[:2] == ["False False False", "None True"], done.stderr


@pytest.mark.skipif(sys.platform != "linux", reason="the wheel is for Linux")
def test_the_wheel_of_this_environment_is_what_drjit_loads():
    done = run_python(
        "from mi_simplify.machine.runtime import ensure_variant\n"
        "import drjit as dr\n"
        "print(ensure_variant(), dr.detail.llvm_version()[0])"
    )
    wheel = importlib.metadata.version(runtime.LLVM_WHEEL).split(".")[0]
    assert done.stdout.split() == ["llvm_ad_rgb", wheel], done.stderr


def test_the_variant_is_the_named_one_then_the_active_one_then_the_environments():
    program = "from mi_simplify.machine.runtime import ensure_variant\nimport mitsuba as mi\n"
    assert "'scalar_rgb' is not supported; use one of llvm_ad_rgb, cuda_ad_rgb" in (
        run_python(program + "ensure_variant()", MI_SIMPLIFY_VARIANT="scalar_rgb").stderr
    )
    done = run_python(program + "mi.set_variant('scalar_rgb'); ensure_variant()")
    assert "'scalar_rgb' is not supported" in done.stderr.splitlines()[-1]
    done = run_python(program + "mi.set_variant('scalar_rgb'); print(ensure_variant('llvm_ad_rgb'), mi.variant())")
    assert done.stdout.split() == ["llvm_ad_rgb", "llvm_ad_rgb"], done.stderr
    assert run_python(program + "print(ensure_variant())", MI_SIMPLIFY_VARIANT="").stdout.strip() == "llvm_ad_rgb"


def test_the_environment_may_say_how_many_threads_compute():
    program = "from mi_simplify.machine.runtime import ensure_variant\nensure_variant()\nimport drjit as dr\n"
    done = run_python(program + "print(dr.thread_count())", MI_SIMPLIFY_THREADS="1")
    assert done.stdout.strip() == "1", done.stderr
    assert "MI_SIMPLIFY_THREADS is 'many'; set it to a number" in run_python(program, MI_SIMPLIFY_THREADS="many").stderr


@pytest.mark.parametrize(
    ("version", "message"),
    [(15, "the LLVM that Dr.Jit loaded is version 15, which aborts"), (-1, "Dr.Jit found no libLLVM")],
)
def test_an_llvm_that_drjit_has_loaded_before_us_is_examined(monkeypatch, version, message):
    import drjit as dr

    monkeypatch.setattr(dr.detail, "llvm_version", lambda: (version, 0, 0))
    with pytest.raises(RuntimeUnavailable, match=f"{message}.*import mi_simplify before drjit"):
        runtime.ensure_variant()


def test_cuda_without_a_gpu_is_one_clear_error(monkeypatch):
    import drjit as dr

    monkeypatch.setattr(dr, "has_backend", lambda backend: False)
    with pytest.raises(RuntimeUnavailable, match="needs an NVIDIA GPU .* use --variant llvm_ad_rgb"):
        runtime.ensure_variant("cuda_ad_rgb")


def test_after_import_calls_back_once_whoever_imports_first(tmp_path):
    (tmp_path / "late.py").write_text("value = 1")
    done = run_python(
        "from mi_simplify.machine.runtime import after_import\n"
        "import sys\n"
        "before = len(sys.meta_path)\n"
        "after_import('late', lambda: print('called', sys.modules['late'].value))\n"
        "import late, importlib; importlib.import_module('late')\n"
        "after_import('late', lambda: print('at once'))\n"
        "print(len(sys.meta_path) - before)",
        PYTHONPATH=str(tmp_path),
    )
    assert done.stdout.splitlines() == ["called 1", "at once", "0"], done.stderr


def test_doctor_runs_a_kernel_and_finds_every_requirement():
    checks = {check.name: check for check in doctor()}
    assert [c for c in checks.values() if c.required and not c.ok] == []
    assert checks["mitsuba"].detail.startswith("3.9")
    assert "gradient" in checks["kernel (llvm_ad_rgb)"].detail
    assert int(checks["cores"].detail) >= 1


def test_doctor_survives_a_process_that_aborts(monkeypatch):
    import mi_simplify.machine.diagnosis as module

    program = "import os, sys; print('LLVM ERROR: Cannot select', file=sys.stderr); os.abort()"
    monkeypatch.setattr(module, "_KERNEL", program)
    check = module._kernel("llvm_ad_rgb")
    assert not check.ok
    assert "SIGABRT: LLVM ERROR: Cannot select" in check.detail
