"""The embedded sample: always the same, detailed enough, and without symmetry."""

import hashlib

import numpy as np
import pytest

from mi_simplify.errors import AssetError
from mi_simplify.initial.reduce.cleanup import clean
from mi_simplify.initial.soup import merge
from mi_simplify.scenes.samples.catalogue import sample_asset, sample_names


@pytest.fixture(scope="module")
def relic():
    return sample_asset("relic:20k")


def digest(asset) -> str:
    h = hashlib.sha256()
    for part in asset.parts:
        for array in (part.vertices, part.faces, part.uvs, part.material.base_color, part.material.specular):
            h.update(np.ascontiguousarray(array).tobytes())
    return h.hexdigest()


def test_the_full_relic_is_detailed_textured_and_part_metal():
    asset = sample_asset("relic")
    assert asset.n_triangles > 100_000
    assert {p.material.base_color.shape[0] for p in asset.parts} >= {1024, 2048}
    metallic = np.concatenate([p.material.specular[..., 2].ravel() for p in asset.parts])
    assert set(np.unique(metallic)) == {0.0, 1.0} and 0.1 < metallic.mean() < 0.9
    roughness = np.concatenate([p.material.specular[..., 1].ravel() for p in asset.parts])
    assert roughness.min() < 0.25 and roughness.max() > 0.6
    for part in asset.parts:
        assert part.uvs.min() >= 0 and np.isfinite(part.vertices).all()


def test_two_calls_give_the_same(relic):
    assert digest(relic) == digest(sample_asset("relic:20k"))


@pytest.mark.parametrize(("name", "wanted"), [("relic:20k", 20_000), ("relic:60000", 60_000)])
def test_size_follows_the_number(name, wanted):
    assert wanted * 0.85 < sample_asset(name).n_triangles < wanted * 1.3


def test_every_closed_part_faces_outwards(relic):
    soup, notes = clean(merge(relic))
    assert not any("rewound" in n for n in notes), notes
    egg = relic.parts[0]
    p = egg.vertices[egg.faces]
    n = np.cross(p[:, 1] - p[:, 0], p[:, 2] - p[:, 0])
    assert (np.einsum("fi,fi->f", n, p.mean(1)) > 0).mean() > 0.95


@pytest.mark.parametrize("axis", [0, 1, 2])
def test_no_mirror_image_looks_the_same(relic, axis):
    points = np.concatenate([p.vertices for p in relic.parts])
    mirrored = points * np.where(np.arange(3) == axis, -1, 1) + 0.0
    bins = [np.linspace(-1.3, 1.3, 14)] * 3
    a, b = (np.histogramdd(x, bins)[0] > 0 for x in (points, mirrored))
    assert (a ^ b).sum() / (a | b).sum() > 0.2


@pytest.mark.parametrize(("name", "modes"), [("shrub", {"OPAQUE"}), ("fern", {"OPAQUE", "MASK"})])
def test_a_plant_is_a_million_triangles_of_few_parts_in_a_tree_of_nodes(name, modes):
    asset = sample_asset(name)
    assert asset.n_triangles > 1_000_000 and len(asset.parts) < 30 and len(asset.instances) > 2000
    assert {p.material.alpha_mode for p in asset.parts} == modes
    depth = {len(i.node.split("/")) for i in asset.instances}
    assert min(depth) >= 2 and len({i.node for i in asset.instances}) > 50
    low, high = asset.bounds
    assert 1 < (high - low).max() < 4
    again = sample_asset(name)
    assert all(np.array_equal(a.to_world, b.to_world) for a, b in zip(asset.instances, again.instances, strict=True))
    small = sample_asset(f"{name}:30k")
    assert 20_000 < small.n_triangles < 45_000 and digest(small) == digest(sample_asset(f"{name}:30k"))


def test_unknown_names_say_what_there_is():
    assert sample_names() == ["relic", "walker", "fish", "shrub", "fern"]
    with pytest.raises(AssetError, match="there is relic, walker, fish, shrub, fern"):
        sample_asset("teapot")
    with pytest.raises(AssetError, match="relic:20k"):
        sample_asset("relic:many")


def test_the_walker_walks_in_a_circle_of_frames():
    asset = sample_asset("walker:4000")
    assert abs(asset.n_triangles - 4000) < 800 and {i.joint for i in asset.instances if i.joint is not None} == {0}
    rig = asset.rig
    assert rig.n_frames == 24 and (rig.parents < np.arange(len(rig.names))).all()
    steps = np.abs(np.diff(np.concatenate([rig.poses, rig.poses[:1]]), axis=0)).max((1, 2, 3))
    assert steps[-1] < 1.1 * steps[:-1].max()  # the last frame leads on to the first
    feet = [p for p in range(len(asset.parts)) if asset.parts[p].name.startswith("leg")]
    heights = np.array([[asset.posed(f).placed()[p].vertices[:, 1].min() for p in feet] for f in range(24)])
    assert np.ptp(heights.min(1)) < 0.1 and np.ptp(heights, axis=0).min() > 0.1  # one stands while the other is lifted
