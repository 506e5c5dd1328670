"""What the tests of hostile files share."""

import time
from pathlib import Path

import pytest

from mi_simplify.errors import AssetError, UserError
from mi_simplify.formats.load import load_asset
from support.tiny_models import corner_pixels, png

OBJ = "v 0 0 0\nv 1 0 0\nv 1 1 0\nvt 0 0\nvt 1 0\nvt 1 1\nusemtl paint\nf 1/1 2/2 3/3\n"
OUTSIDE = "outside the model's folder.*MI_SIMPLIFY_ASSET_ROOT"
TRIANGLE = """def Mesh "T"
{
    int[] faceVertexCounts = [3]
    int[] faceVertexIndices = [0, 1, 2]
    point3f[] points = [(0, 0, 0), (1, 0, 0), (1, 1, 0)]
}
"""


def with_secret(tmp_path: Path) -> tuple[Path, Path]:
    """A folder for the model, and one beside it with what it must not see."""
    inside, secret = tmp_path / "model", tmp_path / "secret"
    (inside / "x").mkdir(parents=True)
    secret.mkdir()
    (secret / "image.png").write_bytes(png(corner_pixels()))
    (secret / "paint.mtl").write_text("newmtl paint\nKd 1 0 0\n")
    (secret / "buffer.bin").write_bytes(bytes(64))
    (secret / "quad.usda").write_text('#usda 1.0\ndef Mesh "S"\n{\n}\n')
    (secret / "shape.xml").write_text('<scene version="3.0.0"><shape type="sphere"/></scene>')
    (secret / "reflectance.spd").write_text("400 0.1\n700 0.2\n")
    (secret / "triangle.obj").write_text(OBJ)
    return inside, secret


def refused(path, match: str, error: type[UserError] = AssetError, seconds: float = 20.0) -> str:
    """The one line that a file ends with."""
    begin = time.monotonic()
    with pytest.raises(error, match=match) as caught:
        load_asset(path)
    assert time.monotonic() - begin < seconds
    assert "\n" not in str(caught.value) and len(str(caught.value)) < 1000
    return str(caught.value)


def write(path: Path, text: str | bytes) -> Path:
    path.write_bytes(text.encode() if isinstance(text, str) else text)
    return path
