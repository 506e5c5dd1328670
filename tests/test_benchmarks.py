"""
Every benchmark runs, on the smallest case that there is. What it measures is not looked at; that it still can is.
"""

import runpy
import sys

import numpy as np
import pytest
from support.heads import morphable
from support.paths import ROOT
from support.short import SHORT
from support.tiny_models import Glb
from support.toy import bumpy_sphere

import mi_simplify as ms
from mi_simplify.formats.gltf.write import write_glb
from mi_simplify.formats.obj.write import write_obj
from mi_simplify.judging import switching

ARGUMENTS = {
    "batch nothing --n 20 --out out": [],
    "batch kills --n 1 --times 1 --out out --set": SHORT,
    "bytes sphere.ply:200 --shares 8 --out out --set": SHORT,
    "characters sample:walker --triangles 300 --out out --set": [
        *SHORT,
        "animation.frames=0:4",
        "--only",
        "fitted over the animation",
    ],
    "curves --asset sphere.ply --triangles 200 --out out --picture curves.png --set": SHORT,
    "damage sphere.ply 200 low.obj": [],
    "demo_picture run --picture demo.png --spp 1": [],
    "detail prefilter sphere.ply --size 32 --triangles 200 --steps 2 --others 2 --views 2 --path 2 --set": SHORT,
    "detail mips sphere.ply --triangles 200 --steps 2 --views 1 --set": SHORT,
    "detail displacement sphere.ply --steps 2 --views 3 --resolution 32 --set": [*SHORT, "initial.triangles=60"],
    "detail tessellations sphere.ply --steps 1 --views 3 --resolution 32 --set": [*SHORT, "initial.triangles=60"],
    "detail chain sphere.ply --budgets 300,100 --steps 2 --set": SHORT,
    "dressi main sphere.glb --images 1 2 --steps 2 --side 32 --texels 32 --spp 1": [],
    "dressi bias --radii .1 --spp 2 --seeds 1": [],
    "dressi reach sphere.ply --triangles 60 --views 2 --side 32 --steps 2 --starts 1 --shifts .1 --rotations 20": [],
    "dressi sphere sphere.ply --triangles 60 --set": SHORT,
    "dressi speed sphere.ply --triangles 60 --texels 64 --views 4 --side 16 --spp 1 --rounds 1": [],
    "dressi reactive sphere.glb --texels 32 --views 2 --side 32 --rounds 1": [],
    "dressi normals sphere.glb --relief --texels 32 --views 2 --side 32 --steps 2": [],
    "dressi_face face.npz --subjects 1 --height 32 --spp 1 --out out --set texture_size=16": [
        "steps=2",
        "resolution=16",
    ],
    "dressi_light --shapes torus --materials metal --roughness .3 --rows 8 --steps 2 --views 2 --side 16 --spp 2": [],
    "end_to_end --smallest sphere.ply": [],
    "estimators --part figure --rounds 2 --samples 1 --dry --only": ["cube"],
    "estimators --part table --rounds 2 --dry --only": ["principled"],
    "files sphere.ply:200 --size 128 --out out": [],
    "foliage --plant plant.glb --triangles 20 --views 1 --spp 1 -o out": [f"--set={setting}" for setting in SHORT],
    "glossy --asset sphere.ply --triangles 200 --picture glossy.jpg --views 4 --spp 1 --set": SHORT,
    "goals sphere.ply:32 --factors .9 --out out --set": [*SHORT, "initial.atlas_size=64"],
    "gradient_table --rounds 2 --dry --only": ["two objects, 1 layer"],
    "gradients --json --steps 2 --row 1 32 200 64": [],
    "morphs face.npz --triangles 200 --targets 2 --poses 1 --views 1 --set": SHORT,
    "quality --assets . --judge judge.py --out out --docs . --only spot,-500 --set": SHORT,
    "representations images --asset sphere.ply --triangles 200 --photographs 10 --side 32 --out out --set": [
        *SHORT,
        "evaluation.views=2",
    ],
    "transfer casting --side 8 --directions 4": [],
    "transfer images cloth --sizes 8": [],
    "transfer blend --size 8 --frames 12 --epochs 1": [],
    "transports --asset sphere.ply --triangles 200 --out out --set": SHORT,
}

#: What a case needs beyond the packages for development.
EXTRAS = {"transfer blend": ["torch", "onnxscript", "onnxruntime"]}

#: Stands for an outside program.
JUDGE = """
import sys
from pathlib import Path
from PIL import Image
Image.new("RGB", (8, 8)).save(sys.argv[-1])
for path in sys.argv[2:5]:
    assert Path(path).is_file()
    print('{"psnr": 30.0, "flip": 0.01, "silhouette_error": 0.01}')
"""


def test_none_is_forgotten():
    assert {line.split()[0] for line in ARGUMENTS} == {path.stem for path in (ROOT / "benchmarks").glob("*.py")}


@pytest.mark.slow
@pytest.mark.parametrize("line", ARGUMENTS)
def test_a_benchmark_runs(line, tmp_path, monkeypatch, capsys):
    for start, modules in EXTRAS.items():
        for module in modules if line.startswith(start) else []:
            pytest.importorskip(module, reason=f"no {module}: install the extra 'transfer'")
    monkeypatch.chdir(tmp_path)
    bumpy_sphere(tmp_path)
    name, *arguments = line.split()
    if name == "demo_picture":
        overrides = ["asset=sphere.ply", "initial.triangles=200", "export.formats=glb", *SHORT, "optimizer.steps=0"]
        ms.run_job(ms.load_config(overrides=overrides), "run")
    if name == "detail":
        arguments[:0] = ["--out", "out"]
        monkeypatch.setattr(switching, "SIZES", (64, 32))
    if name == "dressi":
        write_glb(ms.first_guess(ms.open_asset("sphere.ply"), triangles=60, atlas_size=32)[0], tmp_path / "sphere.glb")
    if name == "dressi_face":
        morphable(tmp_path / "face.npz")
    if name == "foliage":
        glb = Glb()
        glb.mesh(glb.quad(glb.material()))
        glb.nodes(*[{"mesh": 0, "translation": [k % 5, k // 5, k % 3]} for k in range(30)])
        glb.save(tmp_path / "plant.glb")
    if name == "morphs":
        x, y = np.meshgrid(*[np.linspace(-1, 1, 17)] * 2)
        neutral = np.stack([x.ravel(), y.ravel(), (1 - x**2 - y**2).ravel()], 1)
        corner = (17 * np.arange(16)[:, None] + np.arange(16)).ravel()[:, None]
        shapes = np.stack([0.3 * neutral * [0, 0, k] for k in (1, 2)]).astype(np.float16)
        names = np.array(["one", "two"])
        np.savez("face.npz", neutral=neutral, quads=corner + [0, 1, 18, 17], expression=shapes, expression_names=names)
    if name == "quality":
        for folder in ("images", "spot"):
            (tmp_path / folder).mkdir()
        write_obj(ms.first_guess(ms.open_asset("sphere.ply"), triangles=1000)[0], tmp_path / "spot" / "spot.obj")
        (tmp_path / "results.md").write_text("")
        (tmp_path / "judge.py").write_text(JUDGE)
    monkeypatch.setattr(sys, "argv", [name, *arguments, *ARGUMENTS[line]])
    monkeypatch.setattr(sys, "path", list(sys.path))
    runpy.run_path(str(ROOT / "benchmarks" / f"{name}.py"), run_name="__main__")
    assert any(tmp_path.iterdir()) or capsys.readouterr().out
