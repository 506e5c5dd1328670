"""Every feature of OBJ and MTL in docs/formats.md in a file of its own: column OBJ says what becomes of it."""

import re

import numpy as np
import pytest
from support.paths import ROOT
from support.tiny_models import corner_pixels, png

from mi_simplify.formats.load import load_asset
from mi_simplify.model.asset import Asset

QUAD = "v 0 0 0{0}\nv 1 0 0{1}\nv 1 1 0{1}\nv 0 1 0{0}\nvt 0 0\nvt 1 0\nvt 1 1\nvt 0 1\n"

#: Of each feature the lines of its material, and whether they have come through.
FEATURES = {
    "base colour": ("map_Kd a.png", lambda a: np.ptp(a.parts[0].material.base_color[..., :3]) > 0.5),
    "roughness, metalness": (
        "Pr 0.25\nPm 0.75",
        lambda a: np.allclose(a.parts[0].material.specular[0, 0, 1:], [0.25, 0.75]),
    ),
    "normal map": ("norm a.png", lambda a: a.parts[0].material.normal is not None),
    "emission": ("Ke 1 0.5 0.25", lambda a: np.allclose(a.parts[0].material.emission.max((0, 1)), [1, 0.5, 0.25])),
    "vertex colours": ("", lambda a: a.parts[0].colors is not None),
    "texture transforms": ("map_Kd -s 2 2 1 a.png", lambda a: np.ptp(a.parts[0].uvs, axis=0).max() > 1.9),
    "clamp and mirror": (
        "map_Kd -clamp on a.png",
        lambda a: a.parts[0].material.lookup("base_color").wraps == ("clamp", "clamp"),
    ),
    "mask": ("map_Kd a.png\nmap_d b.png", lambda a: a.parts[0].material.alpha_mode == "MASK"),
    "blending": ("d 0.5", lambda a: a.parts[0].material.alpha_mode == "BLEND"),
}


def read(folder, name: str) -> Asset:
    (folder / "a.png").write_bytes(png(corner_pixels()))
    (folder / "b.png").write_bytes(png(np.uint8([[0, 255]] * 2)))
    colors = (" 1 0 0", " 0 1 0") if name == "vertex colours" else ("", "")
    (folder / "a.mtl").write_text(f"newmtl m\nKd 0.5 0.5 0.5\n{FEATURES[name][0]}\n")
    (folder / "a.obj").write_text("mtllib a.mtl\nusemtl m\n" + QUAD.format(*colors) + "f 1/1 2/2 3/3 4/4\n")
    return load_asset(folder / "a.obj")


@pytest.mark.parametrize("name", FEATURES)
def test_a_feature_comes_through(name, tmp_path):
    asset = read(tmp_path, name)
    assert FEATURES[name][1](asset), asset.parts[0].material
    assert not any("left out" in note for note in asset.notes)


def test_the_table_of_the_documentation_says_what_happens():
    text = (ROOT / "docs" / "formats.md").read_text(encoding="utf-8")
    rows = re.findall(r"^\| ([^|]+?) \| [^|]+? \| [^|]+? \| ([^|]+?) \|$", text, re.M)
    column = {name: verdict for name, verdict in rows if name not in ("feature", "---")}
    kept = {name for name, verdict in column.items() if verdict.split()[0] in ("baked", "carried", "read")}
    assert kept == set(FEATURES)
