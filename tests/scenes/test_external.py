"""Other renderers: VTK, and programs that are started with a JSON of views."""

import json
import sys
from pathlib import Path

import numpy as np
import pytest

from mi_simplify import cli
from mi_simplify.config import load_config
from mi_simplify.errors import AssetError, ConfigError, UserError
from mi_simplify.export import export_model
from mi_simplify.initial.sphere import sphere
from mi_simplify.model.asset import Asset, Instance, Material, Part
from mi_simplify.scenes.references.command import CommandReference
from mi_simplify.scenes.references.path_traced import make_reference
from mi_simplify.scenes.views import goniometer, look_at
from mi_simplify.subjects import open_subject

#: A renderer in a few lines: a ball of radius 0.8, diffuse, white, as what is lit by the light of each frame.
RENDERER = """
import json, sys
from pathlib import Path
import numpy as np
from PIL import Image

path = Path(sys.argv[1])
document = json.loads(path.read_text())
w, h = document["w"], document["h"]
document["color_space"], document["alpha"] = "linear", "straight"
for frame in document["frames"]:
    m = np.array(frame["transform_matrix"])
    x = (np.arange(w) + 0.5 - w / 2) / frame["fl_x"]
    y = -(np.arange(h) + 0.5 - h / 2) / frame["fl_x"]
    d = np.stack(np.broadcast_arrays(x[None], y[:, None], -1.0), -1) @ m[:3, :3].T
    d /= np.linalg.norm(d, axis=-1, keepdims=True)
    o = m[:3, 3]
    b = d @ o
    k = b * b - o @ o + 0.64
    p = o + (-b - np.sqrt(np.maximum(k, 0)))[..., None] * d
    light = np.array(frame["light"]["position"]) - p
    r2 = (light**2).sum(-1)
    value = (p / 0.8 * light).sum(-1) / r2**1.5 * frame["light"]["intensity"][0] / np.pi
    albedo = 0.5 if document["asset"] == "ball" else 0.1
    rgba = np.stack([value * albedo] * 3 + [k > 0], -1)
    frame["file_path"] = frame["file_path"].replace(".exr", ".png")
    Image.fromarray(np.uint8(np.clip(rgba, 0, 1) * 255)).save(path.parent / frame["file_path"])
path.write_text(json.dumps(document))
"""


def ball(roughness=1.0, metallic=0.0, uvs=False) -> Asset:
    positions, faces = sphere(3000)
    base = np.float32([[[0.5, 0.3, 0.1, 1]]])
    material = Material(base_color=base, specular=np.float32([[[0, roughness, metallic]]]))
    uv = np.stack([0.5 + positions[:, 0] / 4, 0.5 - positions[:, 1] / 4], 1).astype(np.float32) if uvs else None
    if uvs:
        image = np.ones((8, 8, 4), np.float32) * [0.2, 0.3, 0.1, 1]
        image[:3, :, 0] = 0.8  # the upper part is red
        image[:, :4, 2] = 0.9  # the left one blue
        material = Material(base_color=image.astype(np.float32), specular=material.specular)
    part = Part(positions, faces, positions.astype(np.float32), uv, material=material)
    return Asset((part,), (Instance(0),))


@pytest.fixture
def vtk_reference():
    pytest.importorskip("vtk")
    from mi_simplify.scenes.references.vtk import VtkReference

    return VtkReference


@pytest.mark.parametrize("asset", [ball(), ball(0.4), ball(0.5, 1.0), ball(uvs=True)])
def test_vtk_shows_what_mitsuba_shows_up_to_what_it_clips(vtk_reference, asset):
    """Same cameras, lights and materials on a film that is not square: two programs that share no code."""
    views = goniometer(3, np.random.default_rng(2), width=48, height=36, distance=4.0, irradiance=1.0)
    other = vtk_reference(asset, spp=16).render(views)
    ours = make_reference(asset, transport="direct", spp=64).render(views)
    assert np.abs(other[..., 3] - ours[..., 3]).mean() < 0.005
    ours[..., :3] = np.clip(ours[..., :3], 0, 1)
    assert np.abs(other - ours)[..., :3].mean() < 0.004
    assert ours[..., :3].max() > 0.1


def test_vtk_refuses_what_it_cannot_show(vtk_reference):
    part = ball().parts[0]
    colors = np.ones((len(part.vertices), 4), np.float32)
    with pytest.raises(AssetError, match="opaque materials without vertex colours"):
        vtk_reference(Asset((Part(part.vertices, part.faces, colors=colors),), (Instance(0),)))


@pytest.fixture
def renderer(tmp_path) -> str:
    (tmp_path / "render.py").write_text(RENDERER)
    return f"{sys.executable} {tmp_path / 'render.py'}"


def test_a_program_renders_the_views_that_it_is_given(renderer):
    views = goniometer(2, np.random.default_rng(3), width=40, height=32, distance=3.5, irradiance=np.pi)
    images = CommandReference(renderer, "ball").render(views)
    positions, faces = sphere(5000)
    material = Material(specular=np.float32([[[1, 1, 0]]]))  # gamma 1: no specular lobe at all but its edge
    part = Part(0.8 * positions, faces, positions.astype(np.float32), material=material)
    ours = make_reference(Asset((part,), (Instance(0),)), transport="direct", spp=64).render(views)
    assert np.abs(images[..., 3] - ours[..., 3]).mean() < 0.02
    whole = (images[..., 3] == 1) & (ours[..., 3] == 1)
    assert np.abs(images[whole] - np.clip(ours[whole], 0, 1)).mean() < 0.02


@pytest.mark.parametrize(
    ("script", "message"),
    [
        ("import sys; sys.exit('no licence')", "ended with code 1: no licence"),
        ("pass", "wrote cannot be used: .*'images/0000.exr' does not exist"),
        ("import sys; open(sys.argv[1], 'w').write('oops')", "wrote cannot be used: .*no JSON"),
        (RENDERER.replace('w, h = document["w"], document["h"]', 'w = h = document["w"] = document["h"] = 7'),
         "wrote an image of 7 × 7 pixels; asked for were 1 of 16 × 16"),
    ],
)  # fmt: skip
def test_a_program_that_fails_is_one_clear_line(tmp_path, script, message):
    (tmp_path / "bad.py").write_text(script)
    views = look_at((0, 0, 3), (0, 0, 0), (0, 0, 3), width=16, height=16, irradiance=np.pi)
    with pytest.raises(UserError, match=message) as caught:
        CommandReference(f"{sys.executable} {tmp_path / 'bad.py'}", "x").render(views)
    assert "\n" not in str(caught.value)


def test_a_program_that_is_not_there_is_one_clear_line():
    views = look_at((0, 0, 3), (0, 0, 0), (0, 0, 3), width=16, height=16, irradiance=np.pi)
    with pytest.raises(UserError, match="'no-such-program -x' cannot be started"):
        CommandReference("no-such-program -x", "x").render(views)


@pytest.mark.parametrize("which", ["vtk", "command"])
def test_the_look_of_another_renderer_is_taken_over(which, tmp_path, renderer, capsys):
    """From the command line; what is judged is the distance to that renderer, before and after."""
    if which == "vtk":
        pytest.importorskip("vtk")
    source = open_subject(load_config(overrides=[f"asset={write_ball(tmp_path)}", "initial.atlas_size=64"]))
    config = source.config.model_copy(update={"initial": source.config.initial.model_copy(update={"triangles": 300})})
    source.config = config
    guess, _ = source.guess()
    asset = export_model(source.frame.restored(guess), tmp_path / "asset")["glb"]
    chosen = "reference.renderer=vtk" if which == "vtk" else f"reference.command={renderer}"
    short = [
        chosen, "optimizer.steps=50", "optimizer.batch=2", "optimizer.resolution=48", "initial.atlas_size=64",
        "reference.spp=4", "reference.pool=16", "evaluation.views=2", "evaluation.resolution=48",
        "evaluation.spp=16", "export.formats=glb", "initial.triangles=200", "optimizer.rates.base_color=0.05",
        "optimizer.rates.specular=0.02",
    ]  # fmt: skip
    command = ["simplify", str(asset), "-o", str(tmp_path / "out"), "-q", *(x for s in short for x in ("--set", s))]
    assert cli.main(command) == 0, capsys.readouterr().err
    figures = json.loads((tmp_path / "out/metrics.json").read_text())
    before, after = (figures["candidates"][name]["psnr"] for name in ("first guess", "result"))
    assert after > before + (3 if which == "command" else -0.5)


def write_ball(folder: Path) -> Path:
    positions, faces = sphere(600)
    lines = [f"v {x} {y} {z}" for x, y, z in 0.8 * positions] + [f"f {a} {b} {c}" for a, b, c in faces + 1]
    (folder / "ball.obj").write_text("\n".join(lines))
    return folder / "ball.obj"


def test_another_renderer_cannot_be_matched():
    with pytest.raises(ConfigError, match="another renderer cannot be matched"):
        open_subject(load_config(overrides=["asset=sample:relic:5k", "reference={renderer: vtk, transport: matched}"]))
