"""Characters from file to file: fits over frames, exports that validators accept, verdicts in frames kept out."""

import json

import mitsuba as mi
import numpy as np
import pytest
from pxr import Gf, Usd, UsdGeom, UsdSkel, UsdUtils, UsdValidation
from support.paths import ROOT

from mi_simplify import cli
from mi_simplify.config import load_config
from mi_simplify.config.presets import STARTS
from mi_simplify.errors import ConfigError
from mi_simplify.export import export_model
from mi_simplify.fitting import Run
from mi_simplify.formats.load import load_asset
from mi_simplify.initial.reduce.weights import bone_weights
from mi_simplify.judging.pruning import pruning_cost
from mi_simplify.judging.self_check import self_check
from mi_simplify.latent.latent import Latent
from mi_simplify.machine.upload import upload
from mi_simplify.model.rig import deform
from mi_simplify.record.checkpoint import Checkpoint
from mi_simplify.scenes.references.path_traced import make_reference
from mi_simplify.scenes.views import held_out_views
from mi_simplify.subjects import open_subject
from mi_simplify.subjects.character import Character, split_frames

SMALL = [
    "initial.triangles=300", "initial.atlas_size=128", "optimizer.steps=20", "optimizer.batch=2",
    "optimizer.resolution=48", "reference.spp=2", "reference.pool=16", "evaluation.resolution=48", "evaluation.spp=4",
    "evaluation.views=4",
]  # fmt: skip
WALKER = {"asset": "sample:walker:2000"}


@pytest.fixture(scope="module")
def subject():
    return open_subject(load_config(None, [WALKER, *SMALL]))


@pytest.fixture(scope="module")
def guess(subject):
    return subject.guess()[0]


@pytest.fixture(scope="module")
def files(subject, guess, tmp_path_factory):
    model = subject.frame.restored(guess)
    return export_model(model, tmp_path_factory.mktemp("walker"), formats=["glb", "usd"])


@pytest.mark.parametrize("form", ["glb", "usd"])
def test_files_show_what_was_fitted(subject, guess, files, form):
    """In two frames; the tangents of GLB are its own, those of USD are made anew."""
    assert self_check(guess, subject.frame.normalised(load_asset(files[form])), resolution=96) > 45


def test_usd_accepts_the_usd(files):
    stage = Usd.Stage.Open(str(files["usd"]))
    registry = UsdValidation.ValidationRegistry()
    metadata = registry.GetAllValidatorMetadata()
    assert any("Skel" in m.name for m in metadata)
    context = UsdValidation.ValidationContext(registry.GetOrLoadAllValidators())
    errors = [e for e in context.Validate(stage) if e.GetType() == UsdValidation.ValidationErrorType.Error]
    assert not errors, [e.GetMessage() for e in errors]
    mesh = next(p for p in stage.Traverse() if p.IsA(UsdGeom.Mesh))
    weights = UsdSkel.BindingAPI(mesh).GetJointWeightsPrimvar()
    rows = np.array(weights.Get()).reshape(-1, weights.GetElementSize())
    assert weights.GetElementSize() == 4 and (np.diff(rows, axis=1) <= 0).all() and np.allclose(rows.sum(1), 1)


def test_usd_poses_the_usd_as_it_is_posed_here(files):
    """Another implementation of skinning, on what was written."""
    asset, stage = load_asset(files["usd"]), Usd.Stage.Open(str(files["usd"]))
    root = UsdSkel.Root(next(p for p in stage.Traverse() if p.IsA(UsdSkel.Root)))
    flat = Usd.Stage.Open(stage.Flatten())  # baking writes into the layer, which others share
    assert UsdSkel.BakeSkinning(UsdSkel.Root(flat.GetPrimAtPath(root.GetPath())), Gf.Interval.GetFullInterval())
    mesh = UsdGeom.Mesh(next(p for p in flat.Traverse() if p.IsA(UsdGeom.Mesh)))
    index = np.array(mesh.GetFaceVertexIndicesAttr().Get())
    for k in (0, 7, 18):
        points = np.array(mesh.GetPointsAttr().Get(asset.rig.codes[k]))[index]
        part = asset.posed(k).placed()[0]
        np.testing.assert_allclose(part.vertices[part.faces].reshape(-1, 3), points, atol=1e-5)


def test_khronos_accepts_the_glb(files, node_run):
    script = (
        "require('gltf-validator').validateBytes(new Uint8Array(require('fs').readFileSync(0)))"
        ".then(r => console.log(JSON.stringify(r.issues)))"
    )
    issues = json.loads(node_run("gltf-validator", script, files["glb"].read_bytes()))
    assert issues["numErrors"] == 0 and issues["numWarnings"] == 0, issues["messages"]


def test_a_usdz_of_the_files_is_read(files, tmp_path):
    package = tmp_path / "walker.usdz"
    assert UsdUtils.CreateNewUsdzPackage(str(files["usd"]), str(package))
    assert load_asset(package).rig.n_frames == 24


def test_the_reference_stands_as_the_asset_poses(subject):
    """The scene whose meshes are moved, against scenes made of posed assets."""
    asset = subject.geometry
    moving = make_reference(asset, spp=64)
    for frame in (3, 15, 3):
        posed = asset.posed(frame)
        views = held_out_views(posed.bounds, 2, 32).at(frame)
        still = make_reference(posed, spp=64).render(views, 1)
        assert np.abs(moving.render(views, 1) - still).mean() < 0.004
    other = moving.render(held_out_views(asset.posed(9).bounds, 2, 32).at(9), 1)
    assert np.abs(other - still).mean() > 0.01


def test_batches_follow_the_character_and_leave_frames_out(subject, guess):
    config = subject.config
    run = Run(guess, subject.reference(), config)
    seen, pool = set(), run.fit.pool
    for _ in range(15):
        pool.grow(8, 48)
        views, _, _ = pool.batch(2)
        (frame,) = set(views.frame.numpy())
        seen.add(int(frame))
        box = guess.skin.boxes[int(frame)]
        away = np.linalg.norm(views.arrays()["origin"] - box.mean(0), axis=1)
        np.testing.assert_allclose(away, config.views.distance * np.ptp(box, axis=0).max() / 2, rtol=1e-4)
    assert seen <= set(subject.fitted) and len(seen) > 6
    assert not seen & set(subject.judged) and len(subject.judged) == 8


def test_the_fit_moves_weights_and_goes_on_where_it_was(subject, guess):
    run = Run(guess, subject.reference(), subject.config)
    for _ in range(3):
        run.step()
    state = run.state()
    weights = run.fit.model().skin.weights
    assert np.allclose(weights.sum(1), 1, atol=1e-5) and (weights >= 0).all()
    assert np.abs(weights - guess.skin.weights).max() > 0.01
    again = Run(guess, subject.reference(), subject.config, state)
    for r in (run, again):
        r.step()
    # Atomic additions of two threads come in any order: the last bit is theirs.
    np.testing.assert_allclose(run.fit.model().skin.weights, again.fit.model().skin.weights, rtol=1e-6, atol=0)


def test_in_the_bind_pose_weights_stay(subject, guess):
    config = load_config(None, [WALKER, *SMALL, "animation.bind_pose_only=true"])
    bound = open_subject(config)
    assert isinstance(bound, Character)
    model = bound.guess()[0]
    run = Run(model, bound.reference(), config)
    run.step()
    assert set(run.fit.held_out.views.frame.numpy()) == {-1}
    np.testing.assert_array_equal(run.fit.model().skin.weights, model.skin.weights)
    assert list(bound.judged) == list(subject.judged)  # of both kinds of fit, the same frames


@pytest.mark.parametrize(
    ("animation", "fitted", "judged"),
    [
        ({"held_out": 4}, 20, [3, 9, 15, 21]),
        ({"held_out": 4, "frames": "0:11"}, 8, [1, 4, 7, 10]),
        ({"held_out": 99, "frames": "0:10:5"}, 2, [5]),
        ({"frames": "7:8"}, 2, [7, 8]),
    ],
)
def test_frames_are_chosen_by_the_numbers_of_the_file(subject, animation, fitted, judged):
    config = load_config(None, [WALKER, {"animation": animation}])
    found = split_frames(subject.geometry.rig, config.animation)
    assert len(found[0]) == fitted and list(found[1]) == judged


def test_weights_follow_the_bones_while_a_sphere_is_fitted():
    """A vertex that moves to another bone is that bone's, unless what is optimised says otherwise."""
    sphere = open_subject(load_config(None, [WALKER, *SMALL, "initial.kind=sphere"]))
    assert sphere.config.optimizer.rates.vertices == 0.05 and sphere.config.optimizer.large_steps.lambda_ == 4
    for rate in (0.3, STARTS["sphere"]["optimizer"]["rates"]["vertices"]):  # whatever it is, if somebody states it
        own = load_config(None, [WALKER, *SMALL, "initial.kind=sphere", f"optimizer.rates.vertices={rate}"])
        assert open_subject(own).config.optimizer.rates.vertices == rate
    guess = sphere.guess()[0]
    rigging, operation = guess.skin, Latent(guess).operation
    moved = 0.6 * guess.mesh.positions
    logits = upload(mi.Float, operation.parameters["skinning"])
    views = held_out_views(rigging.boxes[6], 1, 8).at(6)
    there = operation.positions(upload(mi.Float, moved.ravel()), {"skinning": logits}, views).numpy().reshape(-1, 3)
    fitted = Latent(guess).model(moved, operation.parameters)
    assert fitted.skin.reach == 0  # from here on the weights are what they are
    weights, _ = bone_weights(rigging.rig, moved)
    assert np.abs(weights - rigging.weights).max() > 0.2
    np.testing.assert_allclose(fitted.skin.weights, weights, atol=0.01)
    np.testing.assert_allclose(there, deform(moved, fitted.skin.skin(), rigging.rig.matrices(6)), atol=2e-3)


def test_frames_beyond_the_clip_are_an_error(subject):
    config = load_config(None, [WALKER, {"animation": {"frames": "60:90"}}])
    with pytest.raises(ConfigError, match="60:90 holds no frame of the clip, which goes from 0 to 23"):
        split_frames(subject.geometry.rig, config.animation)


def test_what_pruning_costs_is_measured(guess):
    cost = pruning_cost(guess, n_views=1, resolution=32)
    assert cost["before"] <= 4 and cost["psnr"] > 60 and cost["moved"] < 1e-6  # the sample has three joints a vertex
    rng = np.random.default_rng(0)
    weights = rng.dirichlet(np.ones(guess.skin.weights.shape[1]), len(guess.mesh.positions)).astype(np.float32)
    torn = guess.__class__(**{**vars(guess), "skin": guess.skin.__class__(**{**vars(guess.skin), "weights": weights})})
    cost = pruning_cost(torn, n_views=1, resolution=32)
    assert cost["before"] > 8 and cost["psnr"] < 45 and cost["moved"] > 0.01


def test_the_command_line_does_all_of_it(tmp_path, capsys):
    """A skinned file in; out come files with skeletons, and figures of frames that were kept out."""
    out = tmp_path / "out"
    argv = ["simplify", WALKER["asset"], "--frames", "0:17", "-o", str(out), "--quiet"]
    settings = [*SMALL, "animation.held_out=4", "export.formats=[glb,usd]"]
    assert cli.main([*argv, *(x for s in settings for x in ("--set", s))]) == 0, capsys.readouterr().err
    figures = json.loads((out / "metrics.json").read_text())
    assert figures["settings"]["frames"] == [2.0, 6.0, 11.0, 15.0]
    assert figures["run"]["self_check"]["psnr"] > 45 and figures["run"]["pruning"]["influences"] == 4
    row = figures["candidates"]["result"]
    assert len(row["per_frame"]["psnr"]) == 4 and row["worst_frame"] == min(row["per_frame"]["psnr"])
    assert row["psnr"] > 25
    assert load_asset(out / "model.glb").rig.n_frames == load_asset(out / "model.usdc").rig.n_frames == 24
    capsys.readouterr()
    judged = ["evaluate", str(out / "model.usdc"), str(out / "model.glb"), "--frames", "0:17", "--views", "3"]
    assert cli.main([*judged, "--resolution", "48", "--spp", "16", "--quiet"]) == 0
    assert float(capsys.readouterr().out.split("PSNR")[1].split()[0]) > 32  # one as the other, but for noise
    picture = ["render", str(out / "model.glb"), "-o", str(tmp_path / "a.png"), "--resolution", "32", "--frame"]
    assert cli.main([*picture, "11.5"]) == 0
    assert cli.main([*picture, "99"]) == 2
    assert "goes from 0 to 23; it has no 99" in capsys.readouterr().err


def test_no_kernel_is_compiled_after_the_third_step(subject, guess):
    """Frames change from step to step, what is compiled does not."""
    import drjit as dr

    def kernels(step) -> set:
        with dr.scoped_set_flag(dr.JitFlag.KernelHistory):
            dr.kernel_history_clear()
            step()
            dr.sync_thread()
            return {k["hash"] for k in dr.kernel_history() if k["type"] == dr.KernelType.JIT}

    config = load_config(None, [WALKER, *SMALL, "optimizer.steps=40"])
    fit = Run(guess, subject.reference(), config).fit
    fit.pool.grow(16, 48)
    threads = dr.thread_count()
    dr.set_thread_count(2)  # what threads add up in private copies is compiled into kernels, but not for one thread
    try:
        seen = set.union(*(kernels(lambda k=k: fit.step(k)) for k in range(1, 4)))
        for k in range(4, 12):
            assert not kernels(lambda k=k: fit.step(k)) - seen, f"step {k} compiled a kernel"
        reference = subject.reference()
        views = [held_out_views(guess.skin.boxes[frame], 2, 48).at(frame) for frame in (1, 5, 9)]
        first, second, third = [kernels(lambda v=v: reference.render(v)) for v in views]
        assert not third - first - second
    finally:
        dr.set_thread_count(threads)


def test_the_configuration_of_the_sample_is_one():
    config = load_config(ROOT / "scenes" / "character.yaml")
    assert isinstance(open_subject(config), Character)


def test_levels_of_a_character_are_refused(tmp_path, capsys):
    assert cli.main(["lod", WALKER["asset"], "--triangles", "300,100", "-o", str(tmp_path / "lod")]) == 2
    assert "run simplify on this character once for each budget" in capsys.readouterr().err


def test_a_first_guess_comes_back_from_its_checkpoint(subject, guess, tmp_path):
    checkpoint = Checkpoint(tmp_path / "checkpoint", subject.config, subject.geometry)
    checkpoint.begin(guess, ["a note"])
    back, notes, state = Checkpoint(tmp_path / "checkpoint", subject.config, subject.geometry).load()
    assert notes == ["a note"] and state is None and back.skin.rig.names == guess.skin.rig.names
    for name in ("weights", "boxes", "fitted", "influences", "reach"):
        np.testing.assert_array_equal(getattr(back.skin, name), getattr(guess.skin, name))
    for name in ("parents", "bind", "poses", "codes", "rate"):
        np.testing.assert_array_equal(getattr(back.skin.rig, name), getattr(guess.skin.rig, name))
