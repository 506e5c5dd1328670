"""Skeletons in: joints, weights and motion of USD and glTF files, and what is said where they are broken."""

import numpy as np
import pytest
from pxr import Gf, Usd, UsdGeom, UsdSkel, Vt
from scipy.spatial import cKDTree
from support.tiny_models import QUAD, Glb

from mi_simplify.errors import AssetError, MeshError
from mi_simplify.export import export_model
from mi_simplify.formats.influences import make_skin
from mi_simplify.formats.load import load_asset
from mi_simplify.model.mesh import Mesh
from mi_simplify.model.model import Model
from mi_simplify.model.rig import Rig, Skin, deform, normal_matrices, turn
from mi_simplify.model.rigging import Rigging
from mi_simplify.scenes.samples.catalogue import sample_asset

HIP, HEAD = "hip", "hip/head"


@pytest.fixture
def stage(tmp_path):
    stage = Usd.Stage.CreateNew(str(tmp_path / "man.usda"))
    UsdGeom.SetStageUpAxis(stage, UsdGeom.Tokens.z)
    stage.SetTimeCodesPerSecond(30)
    return stage


def skeleton(stage, joints=(HIP, HEAD), n_bind=2, n_rest=2) -> UsdSkel.Skeleton:
    root = UsdSkel.Root.Define(stage, "/Man")
    UsdGeom.XformCommonAPI(root).SetRotate((10, 20, 30))
    out = UsdSkel.Skeleton.Define(stage, "/Man/Skeleton")
    UsdGeom.XformCommonAPI(out).SetTranslate((1, 2, 3))
    out.CreateJointsAttr(list(joints))
    out.CreateBindTransformsAttr([Gf.Matrix4d(1).SetTranslate((0, 0, k)) for k in range(n_bind)])
    out.CreateRestTransformsAttr([Gf.Matrix4d(1).SetTranslate((0, 0, k)) for k in range(n_rest)])
    return out


def animate(stage, target, joints=(HIP, HEAD), codes=(5, 8, 15)) -> None:
    """Joints in another order than the skeleton's where the caller says so; keys lie some codes apart."""
    animation = UsdSkel.Animation.Define(stage, "/Man/Walk")
    animation.CreateJointsAttr(list(joints))
    rng = np.random.default_rng(3)
    for code in codes:
        q = rng.normal(size=(len(joints), 4))
        q /= np.linalg.norm(q, axis=1, keepdims=True)
        animation.CreateRotationsAttr().Set(Vt.QuatfArray([Gf.Quatf(*map(float, row)) for row in q]), code)
        animation.CreateTranslationsAttr().Set(
            Vt.Vec3fArray.FromNumpy(rng.normal(size=(len(joints), 3)).astype("f4")), code
        )
        animation.CreateScalesAttr().Set(Vt.Vec3hArray([Gf.Vec3h(1, 1, 1)] * len(joints)), code)
    UsdSkel.BindingAPI.Apply(target.GetPrim()).CreateAnimationSourceRel().SetTargets(["/Man/Walk"])


def mesh(stage, name="Body", joints=(0, 1, 0, 1), weights=(1.0, 0.0, 0.5, 0.5), own=None) -> UsdGeom.Mesh:
    """A quad with two joints a point, the same at all of them but the first two."""
    out = UsdGeom.Mesh.Define(stage, f"/Man/{name}")
    out.CreatePointsAttr(Vt.Vec3fArray.FromNumpy(QUAD.astype("f4")))
    out.CreateFaceVertexCountsAttr([4])
    out.CreateFaceVertexIndicesAttr([0, 1, 2, 3])
    out.CreateSubdivisionSchemeAttr("none")
    UsdGeom.XformCommonAPI(out).SetTranslate((70, 0, 0))  # does not count
    binding = UsdSkel.BindingAPI.Apply(out.GetPrim())
    if joints is not None:
        binding.CreateJointIndicesPrimvar(False, 2).Set([*joints, *joints])
        binding.CreateJointWeightsPrimvar(False, 2).Set([*weights, *weights])
    binding.CreateGeomBindTransformAttr(Gf.Matrix4d(1).SetTranslate((0, 0, 0.5)))
    if own is not None:
        binding.CreateJointsAttr(list(own))
    return out


def bind(prim, target="/Man/Skeleton") -> None:
    UsdSkel.BindingAPI.Apply(prim.GetPrim()).CreateSkeletonRel().SetTargets([target])


def saved(stage):
    stage.GetRootLayer().Save()
    return stage.GetRootLayer().realPath


def assert_as_baked(path: str) -> None:
    """All positions in all frames are those of USD's own skinning, to 1e-5 of the size."""
    asset = load_asset(path)
    stage = Usd.Stage.Open(path)
    for prim in [p for p in stage.Traverse() if p.IsA(UsdSkel.Root)]:
        assert UsdSkel.BakeSkinning(UsdSkel.Root(prim), Gf.Interval.GetFullInterval())
    up = np.eye(3)
    if UsdGeom.GetStageUpAxis(stage) == UsdGeom.Tokens.z:
        up = np.array([[1.0, 0, 0], [0, 0, 1], [0, -1, 0]])
    meshes = [UsdGeom.Mesh(p) for p in stage.Traverse() if p.IsA(UsdGeom.Mesh)]
    assert meshes and asset.rig is not None
    sampled = meshes[0].GetPointsAttr().GetTimeSamples()  # between these, baked points take the straight way
    assert len(sampled) > 2 and set(sampled) <= set(asset.rig.codes)
    for code in sampled:
        k = int(np.flatnonzero(asset.rig.codes == code)[0])
        parts = asset.posed(k).placed()
        assert len(parts) == len(meshes)
        for part, baked in zip(parts, meshes, strict=True):
            points = np.array(baked.GetPointsAttr().Get(code), np.float64)
            world = np.array(UsdGeom.XformCache(code).GetLocalToWorldTransform(baked.GetPrim())).T
            points = (points @ world[:3, :3].T + world[:3, 3]) @ up.T
            corners = points[np.array(baked.GetFaceVertexIndicesAttr().Get())]
            found = part.vertices[part.faces].reshape(-1, 3)
            size = np.ptp(points, axis=0).max()
            assert cKDTree(corners).query(found)[0].max() < 1e-5 * size


def test_posed_positions_are_those_of_usd(stage):
    """Joint orders of mesh, skeleton and animation differ; meshes inherit their skeleton, one is rigid; Z is up."""
    target = skeleton(stage)
    animate(stage, target, joints=(HEAD, HIP))
    mesh(stage, "Body")
    mesh(stage, "Hat", own=(HEAD, HIP), joints=(0, 1, 1, 0), weights=(0.75, 0.25, 0.5, 0.5))
    rigid = UsdSkel.BindingAPI(mesh(stage, "Shield", joints=None))
    rigid.CreateJointIndicesPrimvar(True, 2).Set([0, 1])
    rigid.CreateJointWeightsPrimvar(True, 2).Set([0.25, 0.75])
    UsdSkel.BindingAPI.Apply(stage.GetPrimAtPath("/Man")).CreateSkeletonRel().SetTargets([target.GetPath()])
    path = saved(stage)
    rig = load_asset(path).rig
    assert_as_baked(path)
    np.testing.assert_array_equal(rig.codes, np.arange(5, 16))
    assert rig.times[-1] == pytest.approx(10 / 30) and rig.names == (HIP, HEAD)
    np.testing.assert_array_equal(rig.parents, [-1, 0])


def test_a_real_character_is_posed_as_usd_poses_it(shared_assets):
    assert_as_baked(str(shared_assets / "cesium_man" / "CesiumMan.usdz"))


def test_a_mesh_without_joints_stands_still_and_that_is_told(stage):
    animate(stage, skeleton(stage))
    bind(mesh(stage))
    bind(mesh(stage, "Stone", joints=None))
    asset = load_asset(saved(stage))
    assert "'Stone' is bound to no joints; it stands still" in asset.notes
    first, last = (asset.posed(k).placed()[1].vertices for k in (0, 9))
    np.testing.assert_allclose(first, last)
    assert np.abs(asset.posed(0).placed()[0].vertices - asset.posed(9).placed()[0].vertices).max() > 0.1


def test_what_hangs_on_a_moving_prim_moves(stage):
    animate(stage, skeleton(stage))
    bind(mesh(stage))
    cart = UsdGeom.Xform.Define(stage, "/Cart")
    cart.AddTranslateOp().Set((0, 0, 0), 5)
    cart.GetOrderedXformOps()[0].Set((10, 0, 0), 15)
    wheel = UsdGeom.Mesh.Define(stage, "/Cart/Wheel")
    wheel.CreatePointsAttr(Vt.Vec3fArray.FromNumpy(QUAD.astype("f4")))
    wheel.CreateFaceVertexCountsAttr([4])
    wheel.CreateFaceVertexIndicesAttr([0, 1, 2, 3])
    asset = load_asset(saved(stage))
    moved = asset.posed(5).placed()[1].vertices - asset.posed(0).placed()[1].vertices
    np.testing.assert_allclose(moved, np.tile([5, 0, 0], (4, 1)), atol=1e-6)


@pytest.mark.parametrize(
    ("broken", "match"),
    [
        (dict(n_bind=1), "has 2 joints but 1 bind transforms"),
        (dict(n_rest=1), "has 2 joints but 1 rest transforms"),
        (dict(joints=()), "has no joints"),
    ],
)
def test_broken_skeletons_are_errors(stage, broken, match):
    skeleton(stage, **broken)
    bind(mesh(stage))
    with pytest.raises(AssetError, match=match):
        load_asset(saved(stage))


def test_a_missing_joint_is_an_error(stage):
    animate(stage, skeleton(stage))
    bind(mesh(stage, own=(HIP, "hip/tail")))
    with pytest.raises(
        AssetError, match="'Body' follows the joint 'hip/tail', which skeleton 'Skeleton' does not have"
    ):
        load_asset(saved(stage))


def test_a_missing_skeleton_is_an_error(stage):
    skeleton(stage)
    bind(mesh(stage), "/Man/Nothing")
    with pytest.raises(AssetError, match="is bound to the skeleton '/Man/Nothing', which does not exist"):
        load_asset(saved(stage))


def test_an_empty_animation_is_told(stage):
    animate(stage, skeleton(stage), codes=())
    bind(mesh(stage))
    asset = load_asset(saved(stage))
    assert asset.rig.n_frames == 1
    assert "the animation of skeleton 'Skeleton' is empty; its one frame is the pose at rest" in asset.notes


def test_weights_are_mended_or_refused():
    points, notes = np.arange(4.0)[:, None] * [1, 0, 0], []
    joints = np.array([[0, 1], [1, 0], [0, 7], [0, 1]])
    weights = np.array([[2.0, 2.0], [0, 0], [1, 0], [-1, 1]])
    skin = make_skin(joints, weights, points, 2, "man.usd", "Body", notes.append)
    np.testing.assert_allclose(skin.matrix(2).toarray(), [[0.5, 0.5], [0.5, 0.5], [1, 0], [0, 1]])
    text = " | ".join(notes)
    assert "1 vertices of 'Body' had weights of sum 0; they follow the closest one that has any" in text
    assert "negative weights" in text and "did not sum to 1" in text
    with pytest.raises(MeshError, match="all weights of 'Body' are 0"):
        make_skin(joints, 0 * weights, points, 2, "man.usd", "Body", notes.append)
    with pytest.raises(MeshError, match="refers to joint 7, but there are 2"):
        make_skin(joints, np.ones((4, 2)), points, 2, "man.usd", "Body", notes.append)


def test_a_glb_is_posed_by_its_keys(tmp_path):
    """Linear rotations in between, steps, and a cubic spline, against their definitions (glTF 2.0, Appendix C)."""
    glb = Glb()
    glb.mesh(glb.quad(JOINTS_0=np.uint8([[0, 1, 0, 0]] * 4), WEIGHTS_0=np.float32([[0.25, 0.75, 0, 0]] * 4)))
    glb.json["skins"] = [{"joints": [1, 2]}]
    glb.nodes({"mesh": 0, "skin": 0}, {"name": "hip", "children": [2]}, {"name": "head"})
    times = glb.accessor(np.float32([1, 2]))
    half = np.sqrt(0.5)
    spline = np.zeros((6, 3), "f4")
    spline[1], spline[4], spline[3] = (0, 0, 0), (0, 2, 0), (0, 1, 0)  # values, and the tangent that leads in
    outputs = [np.float32([[0, 0, 0, 1], [0, 0, half, half]]), spline]
    glb.json["animations"] = [{
        "samplers": [
            {"input": times, "output": glb.accessor(outputs[0])},
            {"input": times, "output": glb.accessor(outputs[1]), "interpolation": "CUBICSPLINE"},
        ],
        "channels": [
            {"sampler": 0, "target": {"node": 1, "path": "rotation"}},
            {"sampler": 1, "target": {"node": 2, "path": "translation"}},
        ],
    }]  # fmt: skip
    asset = load_asset(glb.save(tmp_path / "a.glb"))
    rig = asset.rig
    assert rig.n_frames == 25 and rig.times[-1] == pytest.approx(1)
    middle = rig.frame_at(0.5)
    c, s = np.cos(np.pi / 8), np.sin(np.pi / 8)
    turn = np.array([[c * c - s * s, -2 * s * c, 0], [2 * s * c, c * c - s * s, 0], [0, 0, 1]])
    lift = 0.5 * 2 + (0.125 - 0.25) * 1  # of y at s = 1/2: (3s² - 2s³) v1 + (s³ - s²) b1
    expected = (QUAD + 0.75 * np.array([0, lift, 0])) @ turn.T
    np.testing.assert_allclose(asset.posed(middle).placed()[0].vertices, expected, atol=1e-5)


def test_broken_glb_skins_are_errors(tmp_path):
    glb = Glb()
    glb.mesh(glb.quad(JOINTS_0=np.zeros((4, 4), "u1"), WEIGHTS_0=np.tile(np.float32([1, 0, 0, 0]), (4, 1))))
    glb.json["skins"] = [{"joints": [0, 5]}]
    glb.nodes({}, {"mesh": 0, "skin": 0})
    with pytest.raises(AssetError, match="has joints that are not in the scene"):
        load_asset(glb.save(tmp_path / "a.glb"))
    glb.json["skins"] = [{"joints": [0], "inverseBindMatrices": glb.accessor(np.zeros((1, 16), "f4"))}]
    with pytest.raises(AssetError, match="has no inverse"):
        load_asset(glb.save(tmp_path / "a.glb"))


def test_normals_stay_perpendicular_under_a_rigid_joint():
    rng = np.random.default_rng(0)
    matrices = np.tile(np.eye(4), (1, 1, 1))
    matrices[0, :3, :3] = np.diag([2.0, 1, 0.5]) @ np.linalg.qr(rng.normal(size=(3, 3)))[0]
    skin = Skin(np.zeros((1, 1), int), np.ones((1, 1)))
    a, b = rng.normal(size=(2, 1, 3))
    moved = [deform(x, skin, matrices) for x in (a, b)]
    normal = turn(np.cross(a, b), skin, normal_matrices(matrices))
    assert abs((normal * moved[0]).sum()) < 1e-6 and abs((normal * moved[1]).sum()) < 1e-6


def character(n_frames=3, seed=0) -> Model:
    """The sample's skeleton with scaled, sheared binds, on a mesh of a few triangles with eight joints a vertex."""
    rng = np.random.default_rng(seed)
    rig = sample_asset("walker:2000").rig.clip(np.arange(n_frames))
    stretch = np.eye(4)
    stretch[:3, :3] = 0.01 * (np.eye(3) + 0.2 * rng.normal(size=(3, 3)))
    rig = Rig(rig.names, rig.parents, rig.bind @ stretch, rig.poses @ stretch, rig.codes + 1, rig.rate)
    weights = rng.random((6, len(rig.names))).astype(np.float32) ** 4
    weights /= weights.sum(1, keepdims=True)
    mesh = Mesh(rng.random((6, 3)), np.arange(6), rng.random((6, 2)).astype("f4"), np.array([[0, 1, 2], [3, 4, 5]]))
    image = np.full((8, 8, 4), 0.5, np.float32)
    flat = np.zeros((8, 8, 3), np.float32)
    flat[..., 2] = 1
    return Model(mesh, image, image[..., :3], flat, skin=Rigging(weights, rig, np.zeros((4, 2, 3)), np.arange(3), 8))


@pytest.mark.parametrize(("form", "n_frames"), [("glb", 3), ("usd", 3), ("glb", 1), ("usd", 1)])
def test_exported_characters_pose_as_they_did(tmp_path, form, n_frames):
    """Eight joints a vertex, in files as in memory; what a bind pose has of scale and shear does not matter."""
    model = character(n_frames)
    written = load_asset(export_model(model, tmp_path, formats=[form])[form])
    expected = Model.as_asset(model.__class__(**{**vars(model), "skin": model.skin.pruned()}))
    assert written.rig.n_frames == n_frames and (written.parts[0].skin.weights > 0).sum(1).max() == 8
    np.testing.assert_allclose(written.rig.times, model.skin.rig.times, atol=1e-6)
    for frame in range(n_frames):
        a, b = (x.posed(frame).placed()[0] for x in (expected, written))
        size = np.ptp(a.vertices, axis=0).max()
        assert np.abs(a.vertices[a.faces] - b.vertices[b.faces]).max() < 1e-5 * size


def test_pruned_weights_are_the_strongest_sorted_and_of_sum_1():
    rigging = character().skin
    pruned = rigging.skin(4)
    assert pruned.weights.shape == (6, 4) and np.allclose(pruned.weights.sum(1), 1)
    assert (np.diff(pruned.weights, axis=1) <= 0).all()
    strongest = np.sort(np.argsort(-rigging.weights, axis=1)[:, :4], axis=1)
    np.testing.assert_array_equal(np.sort(pruned.joints, axis=1), strongest)
