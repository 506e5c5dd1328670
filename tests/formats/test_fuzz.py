"""A slice of the fuzzer, and that it sees what it looks for; `make fuzz` does twenty thousand inputs."""

import importlib
import re
import subprocess
import sys

from support.paths import ROOT

from mi_simplify.formats.usd import read as read_usd

FUZZ = ROOT / "tests" / "fuzz" / "fuzz.py"


def test_two_hundred_damaged_files(tmp_path):
    command = [sys.executable, str(FUZZ), "--inputs", "200", "--seconds", "100", "--findings", str(tmp_path)]
    done = subprocess.run(command, capture_output=True, text=True, timeout=120, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
    counted = re.search(r"^(\d+) inputs in .* 0 findings", done.stdout, re.MULTILINE)
    assert counted and int(counted[1]) == 200, done.stdout


def test_what_is_damaged_was_good_before(tmp_path, monkeypatch):
    """A seed that is refused as it is would fuzz nothing but the refusal."""
    monkeypatch.syspath_prepend(str(FUZZ.parent))
    monkeypatch.setattr(read_usd, "rehearse", lambda path: None)  # half a second each
    fuzz = importlib.import_module("fuzz")
    for k, seed in enumerate(fuzz.seeds()):
        folder = tmp_path / str(k)
        folder.mkdir()
        for name, data in seed.files.items():
            (folder / name).write_bytes(data)
        fuzz.read(folder / seed.entry)


BROKEN = """
import os, sys, time
from pathlib import Path
import numpy as np
sys.path.insert(0, sys.argv[1])
import fuzz
from mi_simplify.errors import UserError

count = 0

def read(entry):
    global count
    count += 1
    if count % 10 == 3:
        raise KeyError("no user error")
    if count % 10 == 5:
        raise UserError("two\\nlines")
    if count % 10 == 7:
        np.float64(1e308) * 10
    if count == 9:
        os.abort()
    if fuzz.mode == "hang":
        time.sleep(60)
    if fuzz.mode == "memory":
        fuzz.held = np.ones(1 << 27)
        time.sleep(0.5)
    raise UserError("one line")

fuzz.read = read
for fuzz.mode, inputs in (("", 12), ("hang", 1), ("memory", 1)):
    sys.argv = ["fuzz.py", "--inputs", str(inputs), "--findings", sys.argv[-1]]
    count, fuzz.LONGEST = 0, 1.0 if fuzz.mode == "hang" else 10.0
    fuzz.LARGEST = 1 << 29 if fuzz.mode == "memory" else 2 << 30
    fuzz.main()
"""


def test_the_fuzzer_finds_what_it_looks_for(tmp_path):
    command = [sys.executable, "-c", BROKEN, str(FUZZ.parent), str(tmp_path)]
    done = subprocess.run(command, capture_output=True, text=True, timeout=120, check=False)
    found = [re.sub(r"^\d+ \S+ ", "", line) for line in done.stdout.splitlines() if " inputs" not in line]
    assert found[0].startswith("KeyError") and found[1].startswith("the message is not one line"), found
    assert found[2].startswith("RuntimeWarning") and found[3].startswith("the process died (exit code -6)"), found
    assert found[4].startswith("KeyError")  # a new worker goes on, and counts anew
    assert found[5] == "longer than 1 s" and re.search("more than 0.5 GB|1 GB of memory", found[6]), found
    assert sorted(int(path.parent.name) for path in tmp_path.glob("*/finding.txt")) == [0, 2, 4, 6, 8, 11]
