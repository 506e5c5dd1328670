"""Decimation: budgets, topology, clean faces, closeness, borders, components."""

import numpy as np
import pytest
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from mi_simplify.errors import MeshError
from mi_simplify.initial.closest import ClosestPoints
from mi_simplify.initial.manifold import edge_pairs
from mi_simplify.initial.reduce.cleanup import clean
from mi_simplify.initial.reduce.decimate import decimate
from mi_simplify.initial.soup import merge
from mi_simplify.initial.sphere import sphere
from mi_simplify.model.topology import weld
from mi_simplify.scenes.samples.catalogue import sample_asset


def bumpy(n=20_000):
    p, f = sphere(n)
    return p * (1 + 0.1 * np.sin(7 * p[:, :1]) * np.cos(5 * p[:, 1:2])) * [1, 1.5, 0.7], f


def torus(columns=120, rows=60):
    u, v = np.meshgrid(np.arange(columns) * 2 * np.pi / columns, np.arange(rows) * 2 * np.pi / rows, indexing="xy")
    r = 2 + 0.7 * np.cos(v)
    p = np.stack([r * np.cos(u), 0.7 * np.sin(v), -r * np.sin(u)], -1).reshape(-1, 3)
    k = np.arange(columns * rows).reshape(rows, columns)
    a, b, c, d = k, np.roll(k, -1, 1), np.roll(np.roll(k, -1, 1), -1, 0), np.roll(k, -1, 0)
    return p, np.concatenate([np.stack([a, b, c], -1).reshape(-1, 3), np.stack([a, c, d], -1).reshape(-1, 3)])


def weld_faces(p, f):
    """Equal positions as one, without the faces that collapse."""
    q, index = weld(p)
    f = index[f]
    return q, f[(f[:, 0] != f[:, 1]) & (f[:, 1] != f[:, 2]) & (f[:, 2] != f[:, 0])]


def check_clean(p, f):
    """No degenerate, no duplicate faces, no vertex unused."""
    assert len(np.unique(np.sort(f, 1), axis=0)) == len(f)
    c = p[f]
    area = np.linalg.norm(np.cross(c[:, 1] - c[:, 0], c[:, 2] - c[:, 0]), axis=1)
    assert area.min() > 0 and np.array_equal(np.unique(f), np.arange(len(p)))


def facing(reference, p, f):
    """Share of the faces that look the way the reference does where they are."""
    c = p[f]
    n = np.cross(c[:, 1] - c[:, 0], c[:, 2] - c[:, 0])
    hit = reference.query(c.mean(1))
    return (np.einsum("fi,fi->f", n, reference.normals[hit.face]) > 0).mean()


def distances(reference, p, f):
    return ClosestPoints(p, f, 50_000).query(reference.corners.mean(1)).distance


@pytest.mark.parametrize("n", [4, 50, 999, 5000])
def test_a_closed_surface_keeps_its_budget_and_topology(n):
    p, f = bumpy()
    q, g = decimate(p, f, n)
    assert n - 1 <= len(g) <= n
    edges, _, counts = edge_pairs(g)
    assert (counts == 2).all() and len(q) - len(edges) + len(g) == 2
    check_clean(q, g)
    if n >= 50:
        assert facing(ClosestPoints(p, f), q, g) == 1


def test_a_handle_survives():
    q, g = decimate(*torus(), n_triangles=300)
    edges, _, counts = edge_pairs(g)
    assert (counts == 2).all() and len(q) - len(edges) + len(g) == 0


def test_planes_and_their_edges_stay_exact():
    n = 12
    p, f = sphere(20_000)
    box = np.clip(p * 3, -1, 1)  # a cube with a fine grid
    q, g = decimate(box, f, 12 * n)
    assert np.abs(np.abs(q).max(1) - 1).max() < 2e-3
    c = q[g]
    assert np.isclose(np.einsum("fi,fi->", c[:, 0], np.cross(c[:, 1], c[:, 2])) / 6, 8, rtol=2e-3)


def test_an_open_border_stays_where_it_is():
    x, y = np.meshgrid(np.linspace(-1, 1, 60), np.linspace(-1, 1, 60))
    p = np.stack([x.ravel(), y.ravel(), 0.2 * np.sin(3 * x.ravel()) * np.sin(2 * y.ravel())], 1)
    k = np.arange(3600).reshape(60, 60)
    a, b, c, d = (s.ravel() for s in (k[:-1, :-1], k[:-1, 1:], k[1:, 1:], k[1:, :-1]))
    q, g = decimate(p, np.concatenate([np.stack([a, b, c], 1), np.stack([a, c, d], 1)]), 300)
    assert 299 <= len(g) <= 300
    edges, _, counts = edge_pairs(g)
    rim = np.unique(edges[counts == 1])
    assert np.abs(np.abs(q[rim, :2]).max(1) - 1).max() < 0.02
    assert np.allclose([q[:, :2].min(), q[:, :2].max()], [-1, 1], atol=0.01)


def test_size_and_place_do_not_matter():
    p, f = bumpy(4000)
    q, g = decimate(p, f, 400)
    r, h = decimate(p * 1e-3 + [5, -7, 11], f, 400)
    assert np.array_equal(g, h) or abs(len(q) - len(r)) <= 1
    reference = ClosestPoints(p, f)
    ratio = distances(reference, q, g).mean() / distances(reference, (r - [5, -7, 11]) * 1e3, h).mean()
    assert 0.95 < ratio < 1.05


def test_the_tip_of_a_spike_is_not_eaten_up():
    """The planes around a tip hardly hold it along its axis; outlines are made of such tips."""
    p, f = sphere(20_000)
    along = np.clip((p[:, 1:2] - 0.9) / 0.1, 0, 1)
    horn = p * [1, 1, 1] + along**3 * [0, 1.5, 0]  # a horn of 1.5 radii, a hundredth of the area
    q, g = decimate(horn, f, 200)
    assert q[:, 1].max() > 2.45
    p, f = sphere(10_000)
    needle = p * [0.01, 0.01, 1.0] + [0, 0, 1.9]  # a component of its own, as long as the body is wide
    q, g = decimate(np.concatenate([p, needle]), np.concatenate([f, f + len(p)]), 300)
    assert q[:, 2].max() > 2.85 and len(g) <= 300


def test_the_tip_of_a_blade_is_not_eaten_up():
    """The same for a sheet with open borders that run together."""
    t, s = (x.ravel() for x in np.meshgrid(np.linspace(0, 1, 200), np.linspace(-1, 1, 9), indexing="ij"))
    p = np.stack([t, 0.05 * (1 - t) * s, 0.05 * np.sin(4 * t)], 1)
    k = np.arange(200 * 9).reshape(200, 9)
    a, b, c, d = (x.ravel() for x in (k[:-1, :-1], k[1:, :-1], k[1:, 1:], k[:-1, 1:]))
    welded = weld_faces(p, np.concatenate([np.stack([a, b, c], 1), np.stack([a, c, d], 1)]))
    q, g = decimate(*welded, n_triangles=12)
    assert len(g) <= 12 and q[:, 0].max() > 0.98


def test_triangles_go_where_the_surface_bends():
    x, y = (g.ravel() for g in np.meshgrid(*[np.linspace(0, 1, 61)] * 2, indexing="ij"))
    p = np.stack([x, y, np.where(x > 0.5, 0.1 * np.sin(20 * x) * np.sin(20 * y), 0)], 1)
    k = np.arange(61 * 61).reshape(61, 61)
    a, b, c, d = (x.ravel() for x in (k[:-1, :-1], k[1:, :-1], k[1:, 1:], k[:-1, 1:]))
    q, g = decimate(p, np.concatenate([np.stack([a, b, c], 1), np.stack([a, c, d], 1)]), 400)
    assert (q[g].mean(1)[:, 0] > 0.5).mean() > 0.8


def test_the_same_input_gives_the_same_mesh():
    first, second = decimate(*bumpy(3000), n_triangles=200), decimate(*bumpy(3000), n_triangles=200)
    assert all(np.array_equal(a, b) for a, b in zip(first, second, strict=True))


def test_crumbs_go_before_the_body_is_squashed():
    p, f = bumpy(4000)
    small, sf = sphere(20)
    parts = [(p, f)] + [(0.005 * small + [2 + k, 0, 0], sf) for k in range(5)] + [(0.8 * p + [0, 4, 0], f)]
    starts = np.cumsum([0] + [len(a) for a, _ in parts])
    positions = np.concatenate([a for a, _ in parts])
    faces = np.concatenate([b + s for (_, b), s in zip(parts, starts, strict=False)])
    q, g = decimate(positions, faces, 200)
    graph = coo_array((np.ones(2 * len(g)), (g[:, [0, 0]].ravel(), g[:, 1:].ravel())), shape=(len(q),) * 2)
    assert connected_components(graph, directed=False)[0] == 2 and 196 <= len(g) <= 200
    assert q[:, 0].max() < 1.5


def test_many_separate_leaves_are_thinned_out():
    rng = np.random.default_rng(0)
    quad = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]])
    size = rng.uniform(0.02, 0.05, (500, 1, 1))
    p = (quad * size + rng.uniform(0, 10, (500, 1, 3))).reshape(-1, 3)
    f = (np.array([[0, 1, 2], [0, 2, 3]]) + 4 * np.arange(500)[:, None, None]).reshape(-1, 3)
    q, g = decimate(p, f, 200)
    assert 190 <= len(g) <= 200
    check_clean(q, g)


def test_the_relic_with_all_its_pieces():
    soup, _ = clean(merge(sample_asset("relic:20k")))
    q, g = decimate(soup.positions, soup.position_faces, 2000)
    assert 1960 <= len(g) <= 2000
    check_clean(q, g)
    reference = ClosestPoints(soup.positions, soup.position_faces)
    assert facing(reference, q, g) > 0.85  # inside a thin ring the other side may be closer
    assert np.quantile(distances(reference, q, g), 0.99) < 0.03


def test_too_small_a_budget_is_refused():
    with pytest.raises(MeshError, match="at least 4"):
        decimate(*bumpy(100), n_triangles=3)
    with pytest.raises(MeshError, match="cannot be reduced below"):
        decimate(*torus(12, 8), n_triangles=4)


def test_real_files(shared_assets):
    from mi_simplify.formats.load import load_asset

    for name, n in (("bishop/bishop.glb", 1500), ("cesium_milk_truck/CesiumMilkTruck.glb", 1000)):
        soup, _ = clean(merge(load_asset(str(shared_assets / name))))
        q, g = decimate(soup.positions, soup.position_faces, n)
        assert 0.98 * n <= len(g) <= n
        check_clean(q, g)
