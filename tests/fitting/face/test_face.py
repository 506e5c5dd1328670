"""Faces from portraits: cameras, terms of the loss and their derivatives, a head found by the command, mistakes."""

import json
import re

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation
from support import heads
from support.tiny_models import Glb

import mi_simplify as ms
from mi_simplify import cli
from mi_simplify.config.commands.face import FaceSettings
from mi_simplify.fitting.face.landmarks import aligned
from mi_simplify.fitting.face.losses import DepthLoss, LandmarkLoss
from mi_simplify.fitting.face.poses import PoseSteps
from mi_simplify.formats.captured.read import read_captured
from mi_simplify.formats.gltf.file import GltfFile
from mi_simplify.integrators.camera import Cameras
from mi_simplify.jobs.faces.morphable import open_morphable
from mi_simplify.latent.latent import Latent
from mi_simplify.machine.meshes import MovingMesh
from mi_simplify.machine.upload import upload


def poses(scale=1.0, resolution=32):
    rng = np.random.default_rng(0)
    rotations = np.diag([1.0, -1, -1]) @ Rotation.from_rotvec(0.2 * rng.normal(size=(2, 3))).as_matrix()
    return PoseSteps(rotations, np.array([[0.1, 0, 4], [0, 0.2, 5]]), scale, 0.4, resolution, 0.01, 0.01), rotations


def test_cameras_are_where_the_poses_say():
    steps, rotations = poses()
    leaves = steps.leaves()
    a = np.array([[0.1, -0.2, 0.3], [0, 0, 0]], np.float32)
    leaves["turn"] = upload(mi.Float, a.ravel())
    arrays = steps.views(leaves).arrays()
    turn = Rotation.from_quat(np.column_stack([a, np.ones(2)])).as_matrix()  # of unnormalised (a, 1)
    expected = rotations @ turn
    np.testing.assert_allclose(arrays["right"], expected[:, 0], atol=1e-6)
    np.testing.assert_allclose(-arrays["up"], expected[:, 1], atol=1e-6)
    np.testing.assert_allclose(arrays["forward"], expected[:, 2], atol=1e-6)
    origin = -np.einsum("bij,bi->bj", expected, [[0.1, 0, 4], [0, 0.2, 5]])
    np.testing.assert_allclose(arrays["origin"], origin, atol=1e-5)


def test_landmarks_and_depth_are_differentiated_by_shape_pose_and_scale(tmp_path):
    """Known values, and central differences in a random direction."""
    settings = FaceSettings(model=str(heads.morphable(tmp_path / "head.npz")), portraits="x", texture_size=8)
    model, marks, _ = open_morphable(settings)
    model = model.transformed(0.1, np.zeros(3))
    latent, (steps, _) = Latent(model), poses(scale=2.0)
    start = model.mesh.positions.astype(np.float32).ravel()
    depth = np.full((2, 32, 32), np.nan, np.float32)
    depth[:, 12:20, 12:20] = 6.0
    far = DepthLoss(depth, 1.0, 1e3)
    rng = np.random.default_rng(1)
    ways = {name: rng.normal(size=dr.width(leaf)) for name, leaf in steps.leaves().items()}
    ways["positions"] = 0.1 * rng.normal(size=len(start))
    tracer = MovingMesh(model.mesh.positions, model.mesh.position_faces)
    marked = LandmarkLoss(marks, rng.uniform(0, 32, (2, len(marks), 2)))

    def losses(t):
        leaves = {k: upload(mi.Float, v.numpy() + t * ways[k]) for k, v in steps.leaves().items()}
        leaves["positions"] = upload(mi.Float, start + t * ways["positions"])
        dr.enable_grad(*leaves.values())
        cameras = Cameras.of(steps.views(leaves))
        tracer.move(dr.detach(leaves["positions"]))
        surface = latent.evaluate(leaves["positions"])
        off = far(tracer.scene, surface, cameras, steps.scale(leaves))
        return leaves, off, marked(leaves["positions"], cameras)

    for k in range(2):
        leaves, *values = losses(0.0)
        dr.backward(values[k])
        found = sum(float(np.sum(dr.grad(leaf).numpy() * ways[name])) for name, leaf in leaves.items())
        eps = 1e-3
        ahead, behind = losses(eps)[1 + k], losses(-eps)[1 + k]
        assert found == pytest.approx((ahead[0] - behind[0]) / (2 * eps), rel=0.03)
        assert abs(found) > 0.01
    near = DepthLoss(depth, 1.0, 0.25)
    leaves, *_ = losses(0.0)
    value = near(tracer.scene, latent.evaluate(leaves["positions"]), Cameras.of(steps.views(leaves)), mi.Float(100.0))
    assert value[0] == pytest.approx(0.25)  # all too far off to count
    dr.backward(value)
    assert not dr.grad(leaves["positions"]).numpy().any()


@pytest.mark.slow
@pytest.mark.parametrize("depth", [True, False])
def test_a_head_is_found_from_its_portraits(tmp_path, depth, capsys):
    config, out = heads.portraits(tmp_path, depth), tmp_path / "out"
    assert cli.main(["face", str(config), "-o", str(out)]) == 0
    figures = json.loads((out / "metrics.json").read_text())
    before, after = (figures["candidates"][name] for name in ("landmarks", "result"))
    assert after["psnr"] > before["psnr"] + 3 and after["psnr"] > 24
    run = figures["run"]
    # A broader ball that is farther away looks nearly alike from the front, and the weights' prior takes the smaller.
    np.testing.assert_allclose(run["weights"], heads.WEIGHTS, atol=0.15)
    assert run["scale"] == pytest.approx(1, abs=0.03 if depth else 1e-6)
    whole, *_ = open_morphable(FaceSettings(model=str(tmp_path / "head.npz"), portraits="x"))
    true = whole.moved_to(heads.WEIGHTS).mesh.positions
    found = ms.load_asset(out / "model.glb").placed()[0].vertices
    nearest = cKDTree(true).query(found)[1]
    moved = aligned(found, true[nearest], with_scale=not depth)
    assert np.linalg.norm(moved - true[nearest], axis=1).mean() < 0.01 * np.ptp(true[:, 1])
    (mesh,) = GltfFile(out / "model.glb", []).json["meshes"]
    assert mesh["extras"]["targetNames"] == ["beak"]
    np.testing.assert_allclose(mesh["weights"], heads.WEIGHTS[2:], atol=0.1)
    captured = read_captured(out / "transforms.json")
    distances = np.linalg.norm(captured.to_world[:, :3, 3], axis=1) * np.linalg.norm(np.ptp(moved, axis=0))
    np.testing.assert_allclose(distances / np.linalg.norm(np.ptp(found, axis=0)), 45, atol=0.6)
    assert (out / "report.html").is_file() and "scale" in capsys.readouterr().out


def _document(path, change):
    document = json.loads((path / "portraits.json").read_text())
    change(document)
    (path / "portraits.json").write_text(json.dumps(document))


@pytest.fixture(scope="module")
def there(tmp_path_factory):
    """A folder of portraits that is right."""
    folder = tmp_path_factory.mktemp("portraits")
    heads.portraits(folder)
    return folder


@pytest.mark.parametrize(
    ("change", "line"),
    [
        (lambda d: d["frames"][1]["landmarks"][2].__setitem__(0, 48.5), "landmark 2 of '1.exr' is at .48.5.* outside"),
        (lambda d: d["frames"][1]["landmarks"].pop(), "every frame needs the same landmarks"),
        (lambda d: [f["landmarks"].pop() for f in d["frames"]], "landmarks in an image, the model"),
        (lambda d: d["frames"][2].pop("depth_path"), "frame '2.exr' has no 'depth_path', others have"),
        (lambda d: d["frames"][0].update(depth_path="no.exr"), "'no.exr' does not exist"),
        (lambda d: d["frames"][0].update(depth_path="0-small.exr"), "the depth of '0.exr' has 8 × 4 but 48 × 64"),
        (lambda d: d.update(w=640), "'0.exr' has 48 × 64 pixels, but 'w' is 640"),
        (lambda d: d["frames"][0].pop("landmarks"), "'landmarks' of '0.exr' should be a list"),
        (lambda d: d.pop("fl_x"), "needs 'camera_angle_x'"),
    ],
)
def test_portraits_that_do_not_fit_are_one_line(there, tmp_path, change, line, rejected):
    for path in there.iterdir():
        (tmp_path / path.name).write_bytes(path.read_bytes())
    mi.Bitmap(np.ones((4, 8, 1), np.float32)).write(str(tmp_path / "0-small.exr"))
    _document(tmp_path, change)

    assert re.search(line, rejected("face", "face.yaml", "-o", "out"))


def test_models_that_do_not_fit_are_one_line(there, tmp_path, rejected):
    for path in there.iterdir():
        (tmp_path / path.name).write_bytes(path.read_bytes())
    arrays = dict(np.load(tmp_path / "head.npz"))
    np.savez(tmp_path / "head.npz", **arrays | {"expression": arrays["expression"][:, :-1]})
    assert "morph targets 'expression' are of shape (1, 207, 3)" in rejected("face", "face.yaml", "-o", "out")
    np.savez(tmp_path / "head.npz", **arrays | {"landmarks": np.array([0, 5000])})
    assert "do not fit its 208 vertices" in rejected("face", "face.yaml", "-o", "out")
    glb = Glb()
    glb.mesh(glb.quad())
    glb.nodes({"mesh": 0})
    glb.save(tmp_path / "plain.glb")
    (tmp_path / "face.yaml").write_text("model: plain.glb\nportraits: portraits.json\n")
    assert "plain: it has no morph targets" in rejected("face", "face.yaml", "-o", "out")
    (tmp_path / "face.yaml").write_text("model: plain.glb\nportrait: portraits.json\n")
    assert "did you mean 'portraits'" in rejected("face", "face.yaml", "-o", "out")
