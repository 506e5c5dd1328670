"""Budgets: a number, a share of the asset's triangles, or vertices as a file has them."""

import pytest
from support.toy import bumpy_sphere

import mi_simplify as ms
from mi_simplify.config import load_config
from mi_simplify.config.amounts import n_bytes, resolved
from mi_simplify.errors import ConfigError, MeshError
from mi_simplify.subjects import open_subject

SMALL = {"atlas_size": 64, "textures": "constant"}


@pytest.fixture(scope="module")
def asset(tmp_path_factory):
    return ms.open_asset(str(bumpy_sphere(tmp_path_factory.mktemp("asset"), 20)))


def test_a_share_is_of_the_triangles_of_the_asset(asset):
    assert resolved("12.5%", 800) == 100 and resolved("1%", 100) == 4 and resolved(77, 800) == 77
    model, _ = ms.first_guess(asset, triangles="25%", **SMALL)
    assert asset.n_triangles == 800 and 190 <= model.n_triangles <= 200


def test_a_subject_knows_the_number_that_a_share_stands_for(asset):
    subject = open_subject(load_config(None, [{"asset": asset.source, "initial": {"triangles": "25%"}}]))
    assert subject.config.initial.triangles == 200


@pytest.mark.parametrize("more", [{}, {"kind": "sphere"}, {"creases": "asset"}])
def test_a_budget_of_vertices_is_nearly_used_and_never_exceeded(asset, more, tmp_path):
    model, notes = ms.first_guess(asset, vertices=150, **SMALL, **more)
    written = ms.load_asset(ms.export_model(model, tmp_path, formats=["glb"])["glb"])
    n = sum(len(part.vertices) for part in written.parts)
    assert 0.9 * 150 <= n <= 150
    assert notes[0] == f"{model.n_triangles} triangles have {n} vertices, of 150 asked for"


def test_vertices_for_which_no_surface_is_small_enough(asset):
    with pytest.raises(MeshError, match=r"a budget of 8 vertices is too small: \d+ are needed|cannot be reduced below"):
        ms.first_guess(asset, vertices=8, creases="all", **SMALL)  # a tetrahedron of sharp edges has 12


@pytest.mark.parametrize("wrong", ["0%", "120%", "30 %%", "twelve", 2.5, True, "-3%"])
def test_what_is_no_budget_is_one_line(wrong):
    with pytest.raises(ConfigError, match="^initial.triangles: should be a number of triangles such as 2000, or a"):
        load_config(None, ["asset=sample:relic", {"initial": {"triangles": wrong}}])


def test_two_budgets_are_one_line():
    with pytest.raises(ConfigError, match="`vertices` and `triangles` do not go together"):
        load_config(None, ["asset=sample:relic", "initial.vertices=2000", "initial.triangles=900"])


def test_bytes_are_written_as_people_do():
    assert [n_bytes(x) for x in ("500kB", "1.5 MB", "2M", "800", 7, None)] == [
        500_000,
        1_500_000,
        2_000_000,
        800,
        7,
        None,
    ]
    for wrong in ("12 parsecs", "0", "", "kB", 1.5, True, -1):
        with pytest.raises(ValueError, match="a size of a file such as 500kB"):
            n_bytes(wrong)
