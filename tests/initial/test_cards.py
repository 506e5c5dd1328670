"""Cards: planes through clusters of leaves, their atlas, and how much they cover."""

import json

import numpy as np
import pytest
from support.parts import leaves, turned

from mi_simplify import cli
from mi_simplify.errors import MeshError
from mi_simplify.formats.load import load_asset
from mi_simplify.initial.cards.cards import cards, is_aggregate
from mi_simplify.initial.cards.clusters import cluster_faces, pieces
from mi_simplify.initial.cards.crossing import crossing_cards
from mi_simplify.initial.cards.layout import lay_out
from mi_simplify.initial.guess import first_guess
from mi_simplify.model.asset import Asset, Instance, Material, Part
from mi_simplify.scenes.references.path_traced import make_reference
from mi_simplify.scenes.samples.catalogue import sample_asset
from mi_simplify.scenes.views import held_out_views


def triangles_of(asset: Asset) -> np.ndarray:
    return np.concatenate([p.vertices[p.faces] for p in asset.placed()])


def coverage(asset: Asset, bounds: np.ndarray) -> np.ndarray:
    """Of 16 views, in pixels."""
    views = held_out_views(bounds, 16, 96, 3)
    return make_reference(asset, transport="baked", spp=16, max_depth=2).render(views)[..., 3].sum((1, 2))


def test_a_card_a_leaf_where_the_budget_allows():
    asset = leaves(12)
    tris = triangles_of(asset)
    clusters = cluster_faces(tris, np.repeat(np.arange(12), 16), np.zeros(192, int), 12)
    assert sorted(np.bincount(clusters.label)) == [16] * 12
    n = np.cross(tris[:, 1] - tris[:, 0], tris[:, 2] - tris[:, 0])
    n /= np.linalg.norm(n, axis=1, keepdims=True)
    assert np.abs(np.einsum("fi,fi->f", n, clusters.axes[clusters.label, 2])).min() > 0.9999
    np.testing.assert_allclose(clusters.growth, 1, atol=1e-6)
    assert np.allclose(clusters.axes @ clusters.axes.transpose(0, 2, 1), np.eye(3), atol=1e-9)
    assert np.allclose(np.linalg.det(clusters.axes), 1)


def test_pieces_are_divided_only_where_they_are_alone():
    tris = triangles_of(leaves(30, seed=1))
    piece = np.repeat(np.arange(30), 16)
    label = cluster_faces(tris, piece, np.zeros(len(tris), int), 10).label
    assert len(np.unique(label)) == 10
    assert all(len(np.unique(label[piece == k])) == 1 for k in range(30))
    label = cluster_faces(tris, piece, np.zeros(len(tris), int), 50).label
    assert len(np.unique(label)) > 30
    assert all(len(np.unique(piece[label == k])) == 1 for k in range(label.max() + 1))


def test_clusters_stay_within_their_nodes():
    tris = triangles_of(leaves(24, seed=2))
    piece = np.repeat(np.arange(24), 16)
    group = np.repeat(np.arange(24) % 3, 16)
    label = cluster_faces(tris, piece, group, 9).label
    assert all(len(np.unique(group[label == k])) == 1 for k in range(label.max() + 1))


def test_growth_is_cauchys():
    """A sphere on one plane: all directions see twice as much as half of the plane's disc."""
    t, k = np.meshgrid(np.linspace(0, np.pi, 25), np.linspace(0, 2 * np.pi, 49)[:-1], indexing="ij")
    p = np.stack([np.sin(t) * np.cos(k), np.cos(t), np.sin(t) * np.sin(k)], -1)
    q = np.roll(p, -1, 1)
    quads = np.stack([p[:-1], p[1:], q[1:], q[:-1]], 2).reshape(-1, 4, 3)
    tris = np.concatenate([quads[:, [0, 1, 2]], quads[:, [0, 2, 3]]])
    zero = np.zeros(len(tris), int)
    assert cluster_faces(tris, zero, zero, 1).growth == pytest.approx(2, rel=0.01)


def test_pieces_part_where_nodes_do():
    faces = np.array([[0, 1, 2], [2, 1, 3], [4, 5, 6], [2, 3, 7]])
    assert pieces(faces, np.zeros(4, int)).tolist() == [0, 0, 1, 0]
    assert len(np.unique(pieces(faces, np.array([0, 0, 0, 1])))) == 3


@pytest.mark.parametrize("size", [64, 200])
def test_cells_do_not_overlap_and_fill_the_atlas(size):
    tris = triangles_of(leaves(40, seed=3))
    clusters = cluster_faces(tris, np.repeat(np.arange(40), 16), np.zeros(len(tris), int), 40)
    layout = lay_out(clusters, tris, size)
    place, card, at = layout.texels(size)
    assert len(np.unique(place)) == len(place) and place.max() < size**2
    assert len(place) > 0.6 * size**2
    assert np.abs(at).max() < 1 + 4 / np.min((layout.high - layout.low)[card] * layout.density)


@pytest.mark.parametrize("output", ["mask", "blend", "opaque"])
def test_coverage_and_color_are_those_of_the_leaves(output):
    asset = leaves(60, seed=4)
    model, notes = cards(asset, 120, atlas_size=192, output=output)
    assert model.n_triangles == 120 and model.base_color.shape == (192, 192, 4)
    assert "60 cards" in notes[0]
    want, have = (coverage(x, asset.bounds) for x in (asset, model.as_asset()))
    assert have.sum() == pytest.approx(want.sum(), rel=0.02)
    assert np.abs(have / want - 1).max() < 0.06
    seen = model.base_color[..., 3] > 0.5
    np.testing.assert_allclose(np.median(model.base_color[seen][:, :3], axis=0), [0.2, 0.5, 0.1], atol=0.01)
    np.testing.assert_allclose(model.normal[seen].mean(0), [0, 0, 1], atol=0.02)
    assert model.alpha_mode == {"mask": "MASK", "blend": "BLEND", "opaque": "OPAQUE"}[output]
    if output == "opaque":
        p = model.mesh.vertices[model.mesh.faces]
        t = triangles_of(asset)
        area = [np.linalg.norm(np.cross(x[:, 1] - x[:, 0], x[:, 2] - x[:, 0]), axis=1).sum() for x in (p, t)]
        assert area[0] == pytest.approx(area[1], rel=0.02)


def test_fewer_cards_than_leaves_still_cover_as_much():
    """Five on each; what a plane hides of those that stand across it, the card makes up for."""
    asset = leaves(100, seed=5, nodes=4)
    model, _ = cards(asset, 40, atlas_size=128, output="blend")
    want, have = (coverage(x, asset.bounds).sum() for x in (asset, model.as_asset()))
    assert have == pytest.approx(want, rel=0.15)


def test_transparent_leaves_stay_so():
    """Holes of a leaf's texture are holes of its card, whichever side is looked at."""
    base = np.ones((64, 64, 4), np.float32)
    base[16:48, 16:48, 3] = 0
    square = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]], float)
    uvs = np.float32([[0, 1], [1, 1], [1, 0], [0, 0]])
    material = Material("holed", base, alpha_mode="MASK")
    part = Part(square, np.array([[0, 1, 2], [0, 2, 3]]), uvs=uvs, material=material)
    model, _ = cards(Asset((part,), (Instance(0),)), 2, atlas_size=64, output="blend")
    opacity = model.base_color[..., 3]
    assert opacity[24:40, 24:40].max() == 0 and opacity[6:12].min() == 0 or opacity[24:40, 4:10].min() > 0.99
    assert 0.65 < opacity.mean() < 0.8


def test_cards_that_cut_through_each_other_are_counted():
    square = np.array([[-1.0, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]])
    upright = 0.8 * square[:, [2, 1, 0]]
    places = [square, upright, upright + [3, 0, 0], square + [0, 0, 2], 0.1 * upright + [0.5, 0.2, 0]]
    assert crossing_cards(np.array(places)) == 2
    assert crossing_cards(np.array([square, square + [0, 0, 0.1]])) == 0
    assert crossing_cards(np.zeros((0, 4, 3))) == 0
    rng = np.random.default_rng(0)
    quads = np.array([0.3 * square @ turned(rng).T + rng.uniform(-1, 1, 3) for _ in range(60)])
    alone = sum(crossing_cards(quads[[i, j]]) for i in range(60) for j in range(i))
    assert crossing_cards(quads) == alone > 20


def test_what_is_too_much_is_an_error():
    with pytest.raises(MeshError, match="at least 2"):
        cards(leaves(3), 1)
    with pytest.raises(MeshError, match="atlas size of at least"):
        cards(leaves(300), 600, atlas_size=32)


def test_plants_are_aggregates_and_the_relic_is_not():
    assert "pieces" in is_aggregate(sample_asset("shrub:20k"), 400)
    assert not is_aggregate(sample_asset("relic:20k"), 1000)
    assert not is_aggregate(leaves(30), 100)


def test_who_makes_one_surface_of_a_plant_hears_of_cards(caplog):
    _, notes = first_guess(sample_asset("shrub:20k"), triangles=400, atlas_size=64, textures="constant")
    (hint,) = [note for note in notes if "--mode cards" in note]
    assert "small separate pieces make up" in hint and hint in caplog.messages


@pytest.mark.parametrize(
    ("mode", "output"), [("auto", "mask"), pytest.param("cards", "opaque", marks=pytest.mark.slow)]
)
def test_cards_from_the_command_line(mode, output, tmp_path, capsys):
    settings = [
        "optimizer.steps=3", "optimizer.batch=2", "optimizer.resolution=32", "initial.atlas_size=128",
        "evaluation.views=1", "evaluation.resolution=32", "evaluation.spp=4", "reference.spp=2", "reference.pool=4",
        "export.formats=[glb]", f"opacity.cards={output}",
    ]  # fmt: skip
    sets = [x for s in settings for x in ("--set", s)]
    line = ["simplify", "sample:shrub:5k", "--mode", mode, "-n", "400", "-o", str(tmp_path / "out"), *sets]
    assert cli.main(line) == 0
    said = "".join(capsys.readouterr())
    assert ("aggregate geometry" in said) == (mode == "auto")
    asset = load_asset(tmp_path / "out" / "model.glb")
    assert 300 < asset.n_triangles <= 400
    assert {p.material.alpha_mode for p in asset.parts} == {"MASK" if output == "mask" else "OPAQUE"}
    figures = json.loads((tmp_path / "out" / "metrics.json").read_text())
    assert any("cards for" in note for note in figures["run"]["notes"])
    assert figures["candidates"]["result"]["psnr"] > 15
    assert cli.main(["simplify", "sample:shrub:5k", "--mode", "cards", "--init", "sphere", "-o", str(tmp_path)]) == 2
