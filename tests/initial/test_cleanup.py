"""Clean-up: what is dropped, swapped, rewound and cut, and what is left alone."""

import tracemalloc

import numpy as np
import pytest

from mi_simplify.errors import MeshError
from mi_simplify.initial.manifold import edge_pairs, winding_flips
from mi_simplify.initial.reduce.cleanup import clean
from mi_simplify.initial.soup import merge
from mi_simplify.initial.sphere import sphere
from mi_simplify.model.asset import Asset, Instance, Material, Part


def asset_of(*parts: Part) -> Asset:
    return Asset(parts, tuple(Instance(k) for k in range(len(parts))))


def soup_of(vertices, faces):
    return merge(asset_of(Part(np.asarray(vertices, float), np.asarray(faces))))


def volume(positions, faces):
    p = positions[faces]
    return np.einsum("fi,fi->", p[:, 0], np.cross(p[:, 1], p[:, 2])) / 6


def sides(faces) -> np.ndarray:
    """How many edges have one face, two, three …"""
    return np.bincount(edge_pairs(faces)[2])[1:]


def test_merge_places_instances_and_keeps_attributes_apart():
    quad = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]], float)
    faces = np.array([[0, 1, 2], [0, 2, 3]])
    red, blue = Material("red"), Material("blue")
    part = Part(quad, faces, uvs=np.float32(quad[:, :2]), material=red)
    other = Part(quad + [1, 0, 0], faces, colors=np.full((4, 4), 0.5, np.float32), material=blue)
    mirror = np.diag([-1.0, 1, 1, 1])
    soup = merge(Asset((part, other), (Instance(0), Instance(1), Instance(0, mirror))))
    assert len(soup.faces) == 6 and len(soup.vertices) == 12
    assert len(soup.positions) == 8  # three quads in a row share two edges
    assert [m.name for m in soup.materials] == ["red", "blue"] and soup.material_index.tolist() == [0, 0, 1, 1, 0, 0]
    assert soup.colors.min() == 0.5 and not soup.has_normals.any()
    assert np.allclose(soup.normals, [0, 0, 1])  # the mirrored instance is rewound


def test_degenerate_duplicate_and_non_finite_faces_go():
    p, f = sphere(80)
    p = np.concatenate([p, [[np.nan, 0, 0]]])
    bad = [[0, 0, 1], [3, 4, 4], f[5], np.roll(f[6], 1), f[7][::-1], [0, 1, len(p) - 1]]
    soup, notes = clean(soup_of(p, np.concatenate([f, bad])))
    assert len(soup.faces) == 80 and sides(soup.position_faces).tolist() == [0, 120]
    text = " | ".join(notes)
    assert "2 degenerate" in text and "3 duplicate" in text and "1 faces with non-finite" in text


def test_rounding_apart_is_welded():
    p, f = sphere(80)
    corners = p[f].reshape(-1, 3)
    corners += np.random.default_rng(0).uniform(-1e-9, 1e-9, corners.shape)
    soup, notes = clean(soup_of(corners, np.arange(240).reshape(-1, 3)))
    assert len(soup.positions) == 42 and sides(soup.position_faces).tolist() == [0, 120]
    assert any("welded" in n for n in notes)


def test_a_crowd_within_the_tolerance_takes_no_memory():
    """What is far smaller than the rest becomes one position; its pairs of positions would be gigabytes."""
    p, f = sphere(20_000)
    far = np.array([[1e9, 0, 0], [1e9, 1e9, 0], [0, 1e9, 1e9]]) + 5e9
    tracemalloc.start()
    soup, notes = clean(soup_of(np.concatenate([p, far]), np.concatenate([f, len(p) + np.arange(3)[None]])))
    assert tracemalloc.get_traced_memory()[1] < 100e6
    tracemalloc.stop()
    assert len(soup.faces) == 1 and f"{len(p) - 1} nearly equal positions welded" in notes


def test_a_sliver_is_swapped_away_without_tearing():
    # two triangles over 0-1-2-3 whose diagonal holds a fifth point, met by one side only
    p = [[0, 0, 0], [2, 0, 0], [2, 2, 0], [0, 2, 0], [1, 1, 0]]
    faces = [[0, 1, 2], [0, 4, 3], [4, 2, 3], [0, 2, 4]]  # the last one has no area
    soup, notes = clean(soup_of(p, faces))
    assert any("swapped" in n for n in notes)
    assert sides(soup.position_faces).tolist() == [4, 4]
    q = soup.vertices[soup.faces]
    area = np.cross(q[:, 1] - q[:, 0], q[:, 2] - q[:, 0])[:, 2] / 2
    assert np.allclose(area, 1) and np.isclose(area.sum(), 4)


@pytest.mark.parametrize("seed", [0, 1])
def test_winding_is_unified_and_turned_outwards(seed):
    p, f = sphere(200)
    turn = np.random.default_rng(seed).random(200) < (0.3, 0.8)[seed]
    soup, notes = clean(soup_of(p, np.where(turn[:, None], f[:, ::-1], f)))
    assert volume(soup.positions, soup.position_faces) > 3.5
    assert any(f"{turn.sum()} faces rewound" in n for n in notes)


def test_a_hollow_keeps_facing_inwards():
    p, f = sphere(200)
    shell = np.concatenate([f, f[:, ::-1] + len(p)])
    soup, notes = clean(soup_of(np.concatenate([p, 0.5 * p]), shell))
    assert notes == []
    assert np.isclose(volume(soup.positions, soup.position_faces), volume(p, f) * (1 - 1 / 8))


def test_an_inside_out_solid_beside_another_is_turned():
    p, f = sphere(200)
    soup, _ = clean(soup_of(np.concatenate([p, p + [3, 0, 0]]), np.concatenate([f, f[:, ::-1] + len(p)])))
    assert np.isclose(volume(soup.positions, soup.position_faces), 2 * volume(p, f))


def test_an_open_sheet_follows_its_larger_part():
    x, y = np.meshgrid(np.arange(6.0), np.arange(6.0))
    p = np.stack([x.ravel(), y.ravel(), 0 * x.ravel()], 1)
    k = np.arange(36).reshape(6, 6)
    a, b, c, d = k[:-1, :-1].ravel(), k[:-1, 1:].ravel(), k[1:, 1:].ravel(), k[1:, :-1].ravel()
    f = np.concatenate([np.stack([a, b, c], 1), np.stack([a, c, d], 1)])
    turned = f.copy()
    turned[:7] = turned[:7, ::-1]
    flip, twisted = winding_flips(p, turned)
    assert twisted == 0 and np.array_equal(np.flatnonzero(flip), np.arange(7))


def test_a_moebius_strip_is_left_alone():
    n = 24
    a = np.arange(n) * 2 * np.pi / n
    rim = [np.stack([(2 + s * np.cos(a / 2)) * np.cos(a), (2 + s * np.cos(a / 2)) * np.sin(a), s * np.sin(a / 2)], 1)
           for s in (-0.5, 0.5)]  # fmt: skip
    p = np.concatenate(rim)
    i, j = np.arange(n), (np.arange(n) + 1) % n
    low, high = np.where(j == 0, n, j), np.where(j == 0, 0, n + j)  # the strip closes with its sides swapped
    f = np.concatenate([np.stack([i, low, high], 1), np.stack([i, high, n + i], 1)])
    flip, twisted = winding_flips(p, f)
    assert twisted == 1 and not flip.any()


def test_nothing_to_simplify_is_said_so():
    with pytest.raises(MeshError, match="no triangles"):
        merge(Asset((), ()))
    with pytest.raises(MeshError, match="no face .* has an area"):
        clean(soup_of([[0, 0, 0], [1, 0, 0], [2, 0, 0]], [[0, 1, 2]]))


def test_a_clean_mesh_passes_unchanged():
    p, f = sphere(500)
    soup, notes = clean(soup_of(p, f))
    assert notes == [] and np.array_equal(soup.position_faces, f) and np.array_equal(soup.positions, p)
