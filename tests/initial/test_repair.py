"""Repair of a damaged reduction: everything back in place, and a sound mesh left exactly as it came."""

import numpy as np
import pytest
from support.damage import damaged

from mi_simplify.initial.closest import ClosestPoints
from mi_simplify.initial.guess import first_guess
from mi_simplify.initial.manifold import edge_pairs
from mi_simplify.initial.reduce.cleanup import clean
from mi_simplify.initial.reduce.decimate import decimate
from mi_simplify.initial.repair.repair import repair
from mi_simplify.initial.soup import merge
from mi_simplify.initial.sphere import sphere
from mi_simplify.model.asset import Asset, Instance, Part
from mi_simplify.model.mesh import Mesh
from mi_simplify.model.model import Model
from mi_simplify.model.topology import vertex_normals
from mi_simplify.scenes.samples.catalogue import sample_asset


@pytest.fixture(scope="module")
def pear():
    """A detailed surface to repair by, and its reduction."""
    p, f = sphere(6000)
    p = p * (1 + 0.1 * np.sin(7 * p[:, :1]) * np.cos(5 * p[:, 1:2])) * [1, 1.5, 0.7]
    return ClosestPoints(p, f), *decimate(p, f, 500)


def broken(p, f, seed=0, **more):
    """The damaged reduction, welded, as a file would hold it."""
    z = np.zeros((4, 4, 4), np.float32)
    mesh = Mesh(p, np.arange(len(p)), np.zeros((len(p), 2), np.float32), f)
    mesh = damaged(Model(mesh, z, z[..., :3], z[..., :3]), seed, **more).mesh
    used, faces = np.unique(mesh.position_faces, return_inverse=True)
    return mesh.positions[used], faces.reshape(-1, 3)


def distances(reference, p, f):
    return reference.query(np.concatenate([p[f].mean(1), p])).distance


def n_open(f) -> int:
    return int((edge_pairs(f)[2] == 1).sum())


def test_a_sound_mesh_stays_to_the_bit(pear):
    reference, p, f = pear
    q, index, notes = repair(p, f, reference)
    assert notes == [] and np.array_equal(q, p) and np.array_equal(index, np.arange(len(p)))


def test_damage_is_undone(pear):
    reference, p, f = pear
    bad, g = broken(p, f)
    q, index, notes = repair(bad, g, reference)
    h = index[g]
    assert np.isfinite(q).all() and len(h) == len(f)
    assert n_open(g) > 40 and n_open(h) < 0.3 * n_open(g)
    before, after, ideal = (distances(reference, *mesh) for mesh in ((bad, g), (q, h), (p, f)))
    assert before.mean() > 8 * ideal.mean() and after.mean() < 1.5 * ideal.mean()
    assert np.quantile(after, 0.99) < 0.2 * np.quantile(before, 0.99)
    assert any("detached pieces put back" in n for n in notes) and any("surface moved" in n for n in notes)


def test_lost_volume_comes_back(pear):
    reference, p, f = pear
    thin = p - 0.05 * vertex_normals(p, f)
    q, index, notes = repair(thin, f, reference)
    assert notes and all("surface moved" in n for n in notes) and np.array_equal(index, np.arange(len(p)))

    def volume(x):
        return np.einsum("fi,fi->", x[f][:, 0], np.cross(x[f][:, 1], x[f][:, 2])) / 6

    assert volume(thin) < 0.9 * volume(p) and volume(q) == pytest.approx(volume(p), rel=0.01)


def test_one_vertex_pushed_through_comes_back(pear):
    reference, p, f = pear
    bad = p.copy()
    bad[100] -= 0.4 * vertex_normals(p, f)[100]
    q, _, notes = repair(bad, f, reference)
    assert "stray vertices drawn back" in " ".join(notes)
    assert distances(reference, bad, f).max() > 0.3 and distances(reference, q, f).max() < 0.03
    c = q[f]
    n = np.cross(c[:, 1] - c[:, 0], c[:, 2] - c[:, 0])
    hit = reference.query(c.mean(1))
    assert (np.einsum("fi,fi->f", n, reference.normals[hit.face]) > 0).all()


def test_parts_that_look_alike_are_not_put_onto_each_other():
    """Identical leaves, each where it belongs: their borders would fit, but the reference says no."""
    rng = np.random.default_rng(0)
    x, y = (g.ravel() for g in np.meshgrid(*[np.linspace(-1, 1, 5)] * 2))
    leaf = np.stack([0.1 * x, 0.1 * y, 0.02 * x * y], 1)
    k = np.arange(25).reshape(5, 5)
    a, b, c, d = (s.ravel() for s in (k[:-1, :-1], k[:-1, 1:], k[1:, 1:], k[1:, :-1]))
    quad = np.concatenate([np.stack([a, b, c], 1), np.stack([a, c, d], 1)])
    p = (leaf + rng.uniform(-0.3, 0.3, (12, 1, 3))).reshape(-1, 3)
    f = (quad + 25 * np.arange(12)[:, None, None]).reshape(-1, 3)
    q, index, notes = repair(p, f, ClosestPoints(p, f))
    assert notes == [] and np.array_equal(q, p)


def test_cards_that_stand_for_something_else_are_left_alone():
    """Two quads through a ball: off the reference in every way, and meant to be."""
    quad = np.array([[-1, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]], float)
    p = np.concatenate([quad, quad[:, [2, 1, 0]], quad + [0, 0, 3]])
    f = (np.array([[0, 1, 2], [0, 2, 3]]) + 4 * np.arange(3)[:, None, None]).reshape(-1, 3)
    q, _, notes = repair(p, f, ClosestPoints(*sphere(3000)))
    assert notes == [] and np.array_equal(q, p)


def test_the_first_guess_repairs_only_where_it_is_asked_to():
    asset = sample_asset("relic:20k")
    soup, _ = clean(merge(asset))
    p, f = decimate(soup.positions, soup.position_faces, 1500)
    bad, g = broken(p, f, 3, pieces=6)
    low = Asset((Part(bad, g),), (Instance(0),), name="low")
    kept, notes = first_guess(asset, mesh=low, atlas_size=128, textures="constant", repair=False)
    assert len(kept.mesh.positions) == len(bad) and not any("put back" in n for n in notes)
    assert np.isin(kept.mesh.positions, bad).all()
    model, notes = first_guess(asset, mesh=low, atlas_size=128)
    assert any("surface moved to the reference" in n for n in notes)
    reference = ClosestPoints(soup.positions, soup.position_faces)
    mended = distances(reference, model.mesh.positions, model.mesh.position_faces)
    # Not more than that: rings and thorns thinner than what was taken off are inside out for good.
    assert mended.mean() < 0.55 * distances(reference, bad, g).mean()
    for image in (model.base_color, model.specular, model.normal, model.mesh.positions):
        assert np.isfinite(image).all()
