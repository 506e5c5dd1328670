"""The Blender extension without a window, in a Python that has bpy: this one, or that of MI_SIMPLIFY_BPY."""

import json
import os
import subprocess
import sys
from importlib.util import find_spec

import pytest
from support.paths import ROOT

#: In place of the command: says something, and gives back what it was given.
COMMAND = """#!/bin/sh
[ "$1" = simplify ] || exit 2
[ "$4" = 77 ] && { echo "error: no such budget"; exit 2; }
while [ "$1" != -o ]; do case "$1" in *.glb) asset=$1;; esac; shift; done
mkdir "$2" && cp "$asset" "$2/model.glb"
"""

SCRIPT = """
import json, sys
import bpy
sys.path.insert(0, sys.argv[1])
import blender
bpy.ops.wm.read_factory_settings(use_empty=True)
blender.register()
bpy.ops.mesh.primitive_cube_add(size=2)
other = bpy.context.object
bpy.ops.mesh.primitive_cone_add(vertices=5, location=(0, 3, 0))
cone = bpy.context.object
done = bpy.ops.object.mi_simplify()
made = [o for o in bpy.data.objects if o not in (cone, other)]
bpy.context.view_layer.objects.active = cone
bpy.context.scene.mi_simplify.triangles = 77
try:
    bpy.ops.object.mi_simplify()
    failed = ""
except RuntimeError as error:
    failed = str(error)
found = [{"name": o.name, "faces": len(o.data.polygons), "at": list(o.matrix_world.translation)} for o in made]
blender.unregister()
print("RESULT" + json.dumps({"done": list(done), "made": found, "failed": failed}))
"""


def test_the_result_stands_beside_the_object_and_errors_are_told(tmp_path):
    python = os.environ.get("MI_SIMPLIFY_BPY") or (sys.executable if find_spec("bpy") else None)
    if python is None:
        pytest.skip("no bpy in this Python, and MI_SIMPLIFY_BPY names no other that has it")
    command = tmp_path / "bin" / "mi-simplify"
    command.parent.mkdir()
    command.write_text(COMMAND)
    command.chmod(0o755)
    path = f"{command.parent}{os.pathsep}{os.environ['PATH']}"
    ran = subprocess.run(
        [python, "-c", SCRIPT, str(ROOT / "integrations")],
        capture_output=True, text=True, timeout=200, env=os.environ | {"PATH": path}, cwd=tmp_path,
    )  # fmt: skip
    assert ran.returncode == 0, ran.stderr[-2000:]
    result = json.loads(next(line for line in ran.stdout.splitlines() if line.startswith("RESULT"))[6:])
    assert result["done"] == ["FINISHED"]
    (cone,) = result["made"]
    assert cone["faces"] == 8 and cone["name"] == "Cone 8", "the active object alone, as triangles"
    assert cone["at"][0] > 2 and cone["at"][1] == pytest.approx(3, abs=1e-5)
    assert "no such budget" in result["failed"]
