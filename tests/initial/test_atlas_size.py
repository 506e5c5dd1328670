"""The side of an atlas follows what the asset shows."""

import numpy as np
import pytest
from support.toy import bumpy_sphere

import mi_simplify as ms
from mi_simplify.config import InitialSettings, load_config
from mi_simplify.config.initial import LARGEST_ATLAS
from mi_simplify.initial.texels import atlas_side, shown_texels
from mi_simplify.model.asset import Asset, Instance, Material, Part
from mi_simplify.subjects import open_subject


def squares(side: int, scale: float = 1.0, n: int = 1) -> Asset:
    """Placements of a square whose texture, of so many texels a side, it shows this share of along u and v."""
    corners = np.array([[0, 0], [1, 0], [1, 1], [0, 1]], np.float32)
    material = Material(base_color=np.ones((side, side, 4), np.float32))
    part = Part(np.c_[corners, np.zeros(4)], np.array([[0, 1, 2], [0, 2, 3]]), uvs=corners * scale, material=material)
    return Asset((part,), tuple(Instance(0) for _ in range(n)))


def test_texels_that_are_shown_are_counted_once_a_placement():
    assert shown_texels(squares(64)) == pytest.approx(64**2)
    assert shown_texels(squares(64, 0.5)) == pytest.approx(32**2)
    assert shown_texels(squares(64, 2.0, n=3)) == pytest.approx(3 * 128**2), "what repeats is baked as often"
    assert shown_texels(squares(1)) == 0


@pytest.mark.parametrize(("side", "expected"), [(16, 64), (200, 256), (400, 512), (2048, LARGEST_ATLAS)])
def test_an_atlas_has_room_for_them_and_ends_at_the_largest(side, expected):
    assert atlas_side(InitialSettings(triangles=4), squares(side), 4) == expected


def test_geometry_without_textures_counts_by_what_is_removed(tmp_path):
    asset = ms.open_asset(str(bumpy_sphere(tmp_path, 100)))  # 10,000 vertices
    few, many = (atlas_side(InitialSettings(triangles=n), asset, n) for n in (500, 19_000))
    assert few == 256 and many == LARGEST_ATLAS
    model, _ = ms.first_guess(asset, triangles=500, textures="constant")
    assert model.base_color.shape[0] == few


@pytest.mark.parametrize("more", [{"kind": "cards"}, {"subdivisions": 2}, {"kind": "mesh", "mesh": "low.obj"}])
def test_what_cannot_be_known_gets_the_largest(more):
    assert atlas_side(InitialSettings(**more), squares(16), 4) == LARGEST_ATLAS


@pytest.mark.parametrize(
    ("settings", "expected"),
    [
        ([], 256),
        (["initial.atlas_size=32"], 32),
        (["initial.atlas_size=48"], 48),
        (["reference.transport=baked"], LARGEST_ATLAS),
        (["reference.transport=baked", "initial.atlas_size=auto"], 256),
    ],
)
def test_a_subject_knows_the_side(settings, expected, tmp_path):
    asset = str(bumpy_sphere(tmp_path, 40))
    subject = open_subject(load_config(None, [{"asset": asset}, "initial.triangles=600", *settings]))
    assert subject.config.initial.atlas_size == expected
