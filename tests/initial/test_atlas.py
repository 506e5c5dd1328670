"""Texels of a UV layout: coverage counted as by hand, overlap found, nothing left uncovered."""

import numpy as np
import pytest

from mi_simplify.initial.unwrap import atlas
from mi_simplify.model.mesh import Mesh


def layout(*triangles) -> Mesh:
    """A mesh whose triangles lie in the texture as given; positions do not matter."""
    uvs = np.float32(triangles).reshape(-1, 2)
    n = len(uvs)
    return Mesh(np.random.default_rng(0).normal(size=(n, 3)), np.arange(n), uvs, np.arange(n).reshape(-1, 3))


LOWER = [(0, 0), (1, 0), (0, 1)]  # below the diagonal of the unit square
UPPER = [(1, 0), (1, 1), (0, 1)]


def test_texels_are_counted_at_their_centres():
    counts = atlas.texel_counts(layout(LOWER), 4)
    # Centres on the diagonal u + v = 1 count for neither side.
    assert counts.tolist() == [[1, 1, 1, 0], [1, 1, 0, 0], [1, 0, 0, 0], [0, 0, 0, 0]]
    turned = atlas.texel_counts(layout(LOWER[::-1]), 4)
    assert np.array_equal(turned, counts)  # mirrored charts cover as much
    assert atlas.texel_counts(layout(LOWER, UPPER), 4).tolist() == (1 - np.fliplr(np.eye(4))).tolist()


def test_what_leaves_the_unit_square_wraps():
    moved = np.array(LOWER) + [3, -2]
    assert np.array_equal(atlas.texel_counts(layout(moved), 8), atlas.texel_counts(layout(LOWER), 8))
    across = atlas.texel_counts(layout(np.array(LOWER) + [0.5, 0]), 4)
    assert across.tolist() == [[1, 0, 1, 1], [0, 0, 1, 1], [0, 0, 1, 0], [0, 0, 0, 0]]


def test_the_work_in_pieces_counts_the_same(monkeypatch):
    mesh = layout(*np.random.default_rng(3).random((40, 3, 2)))
    whole = atlas.texel_counts(mesh, 64)
    monkeypatch.setattr(atlas, "_CHUNK", 500)
    assert np.array_equal(atlas.texel_counts(mesh, 64), whole)
    (a, b), (c, d) = (np.diff(mesh.uvs[mesh.faces].astype(float), axis=1)[:, k].T for k in (0, 1))
    area = np.abs(a * d - b * c).sum() / 2
    assert whole.sum() == pytest.approx(area * 64**2, rel=0.02)


def test_overlap_is_a_share_of_what_is_covered():
    assert atlas.overlap_fraction(layout(LOWER, UPPER)) == 0
    assert atlas.overlap_fraction(layout(LOWER, LOWER[::-1])) == 1
    half = np.array(LOWER) * [0.5, 1]
    assert atlas.overlap_fraction(layout(LOWER, half)) == pytest.approx(0.5, abs=0.01)
    assert atlas.overlap_fraction(layout([(0, 0)] * 3)) == 0


def test_dilation_takes_the_nearest_texel_for_every_image():
    covered = np.zeros((9, 9), bool)
    covered[1, 1] = covered[7, 6] = True
    value = np.zeros((9, 9, 1), np.float32)
    value[1, 1], value[7, 6] = 1, 2
    a, b = atlas.dilate([value, -value], covered)
    y, x = np.indices((9, 9))
    nearer = (y - 1) ** 2 + (x - 1) ** 2 < (y - 7) ** 2 + (x - 6) ** 2
    tie = (y - 1) ** 2 + (x - 1) ** 2 == (y - 7) ** 2 + (x - 6) ** 2
    assert np.array_equal(a[..., 0][~tie], np.where(nearer, 1, 2)[~tie])
    assert np.array_equal(b, -a)


def test_dilation_of_all_or_nothing_changes_nothing():
    image = np.random.default_rng(0).random((4, 5, 3)).astype(np.float32)
    for covered in (np.ones((4, 5), bool), np.zeros((4, 5), bool)):
        assert atlas.dilate([image], covered)[0] is image
