"""Sequences, baked images, the linear model, and the figures of both."""

import numpy as np
import pytest
from support.folding import folding

from mi_simplify.errors import AssetError, MeshError
from mi_simplify.scenes.samples.catalogue import sample_asset
from mi_simplify.transfer.dataset import bake, load_dataset
from mi_simplify.transfer.judge import judge
from mi_simplify.transfer.linear import fit_linear
from mi_simplify.transfer.sequences.cloth import cloth
from mi_simplify.transfer.sequences.files import folder, skinned
from mi_simplify.transfer.sequences.sequence import Sequence


@pytest.fixture(scope="module")
def baked():
    return bake(folding(), 16, n_directions=64)


def test_frames_for_tests_are_not_trained_on(baked):
    assert len(baked.training) == 18 and list(baked.held_out) == [18, 19]


def test_a_fold_loses_light(baked):
    """The deeper the fold the less reaches its bottom."""
    middle = baked.transfer[:, 7 * 16 + 7, 0]
    assert middle[-1] < 0.6 * middle[0]


def test_a_file_holds_it_all(baked, tmp_path):
    again = load_dataset(baked.save(tmp_path / "data.npz"))
    np.testing.assert_allclose(again.transfer, baked.transfer, atol=1e-3)
    np.testing.assert_array_equal(again.positions, baked.positions)
    assert again.figures == baked.figures and again.albedo == baked.albedo
    (tmp_path / "data.npz").write_bytes(b"nothing")
    with pytest.raises(AssetError, match="a file of 'transfer bake' expected"):
        load_dataset(tmp_path / "data.npz")


def test_the_linear_model_knows_its_training_and_beats_no_shadows(baked):
    model = fit_linear(baked)
    figures = judge(baked, {"linear": model}, size=48)
    assert figures["linear"]["l1"] < figures["unshadowed"]["l1"]
    assert figures["linear"]["psnr"] > figures["unshadowed"]["psnr"] + 3
    perfect = judge(baked, {"rays": lambda p, n: baked.transfer[baked.held_out]}, size=48)
    assert perfect["rays"] == {"l1": 0.0, "psnr": 100.0}


def test_cloth_is_the_same_every_time_and_does_not_tear():
    a, b = cloth(3, 16), cloth(3, 16)
    np.testing.assert_array_equal(a.frames, b.frames)
    g = a.frames.reshape(3, 16, 16, 3)
    edges = np.linalg.norm(np.diff(g, axis=2), axis=3) * 15
    assert edges.max() < 1.5 and np.median(edges) == pytest.approx(1, abs=0.1)


def test_the_fish_is_one_surface_that_swims():
    sequence = skinned(sample_asset("fish:2000"), 5)
    assert np.abs(sequence.frames[0] - sequence.frames[2]).max() > 0.1
    image = bake(sequence, 24, n_directions=16)
    assert image.figures["flipped"] == 0


def test_folders_of_frames_must_agree(tmp_path):
    text = "v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\nf 1 2 3\n"
    (tmp_path / "a.obj").write_text(text + "f 1 3 4\n")
    (tmp_path / "b.obj").write_text(text.replace("1 1 0", "1 1 1") + "f 1 3 4\n")
    assert folder(tmp_path).frames.shape == (2, 4, 3)
    (tmp_path / "c.obj").write_text(text + "f 1 4 3\n")
    with pytest.raises(MeshError, match="c.obj: the faces of a.obj expected"):
        folder(tmp_path)


def test_frames_that_are_not_finite_are_refused():
    frames = folding().frames.copy()
    frames[7, 3] = np.nan
    with pytest.raises(MeshError, match="frame 7 has NaN"):
        Sequence("broken", folding().faces, frames, frames[0])


def test_several_parts_ask_for_one():
    with pytest.raises(AssetError, match="choose with 'part' one of torso, head"):
        skinned(sample_asset("walker:2000"), 3)
