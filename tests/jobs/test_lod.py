"""Chains of levels of detail: sizes that are measured, and files that hold all levels."""

import json
from dataclasses import replace

import numpy as np
import pytest
from pxr import Usd, UsdLod
from support.tiny_meshes import charted_sphere
from support.toy import bumpy_sphere

from mi_simplify import cli
from mi_simplify.export import export_model
from mi_simplify.export.lods import coverage, join_glb, join_usd
from mi_simplify.formats.gltf.file import GltfFile
from mi_simplify.judging.switching import SIZES, switching_size
from mi_simplify.model.model import Model

SHORT = [
    "optimizer.steps=3", "optimizer.batch=2", "optimizer.resolution=32", "initial.atlas_size=64", "evaluation.views=1",
    "evaluation.resolution=32", "evaluation.spp=2", "reference.spp=1", "reference.pool=2", "initial.oversample=1",
]  # fmt: skip


def ball(n: int, size: int = 16, noise: float = 0.0) -> Model:
    base_color, specular = (np.full((size, size, c), 0.5, np.float32) for c in (4, 3))
    base_color[..., 3], specular[..., ::2] = 1, 0
    return Model(charted_sphere(n, noise), base_color, specular, np.tile(np.float32([0, 0, 1]), (size, size, 1)))


def test_rougher_levels_take_over_at_smaller_sizes():
    fine, bounds = ball(8), np.array([[-1.0] * 3, [1.0] * 3])
    sizes = []
    for noise in (0.02, 0.01, 0.0):
        size, found = switching_size(fine, ball(8, noise=noise), bounds, 0.05, largest=128, n_views=1)
        alike = [s for s in found if found[s] < 0.05]
        assert size >= max(alike, default=SIZES[-1]) and all(size <= s for s in found if found[s] >= 0.05)
        sizes.append(size)
    assert sizes == sorted(sizes) and sizes[0] < sizes[1] and sizes[-1] == 128
    assert max(found.values()) == pytest.approx(0, abs=1e-6)


@pytest.fixture(scope="module")
def files(tmp_path_factory):
    """Three levels as GLB and USD, and all of them in one file each."""
    folder = tmp_path_factory.mktemp("levels")
    models = [replace(ball(n), name=f"ball {n}") for n in (6, 4, 2)]
    for k, model in enumerate(models):
        export_model(model, folder / f"lod{k}", formats=("glb", "usd"))
    join_glb([folder / f"lod{k}" / "model.glb" for k in range(3)], [200.0, 50.0], folder / "lods.glb")
    bounds = np.array([[-1.0] * 3, [1.0] * 3])
    join_usd([f"lod{k}/model.usdc" for k in range(3)], [200.0, 50.0], bounds, folder / "lods.usda")
    return folder, models


def test_one_glb_has_all_levels(files):
    folder, models = files
    file = GltfFile(folder / "lods.glb", [])
    document = file.json
    (root,) = document["scenes"][0]["nodes"]
    ids = [root, *document["nodes"][root]["extensions"]["MSFT_lod"]["ids"]]
    shares = document["nodes"][root]["extras"]["MSFT_screencoverage"]
    assert shares == [pytest.approx(coverage(200.0)), pytest.approx(coverage(50.0)), 0.0] and shares[0] < 0.02
    assert document["extensionsUsed"] == ["MSFT_lod"] and len(document["buffers"]) == 1
    for k, (node, model) in enumerate(zip(ids, models, strict=True)):
        alone = GltfFile(folder / f"lod{k}" / "model.glb", [])
        for f, mesh in ((file, document["nodes"][node]["mesh"]), (alone, 0)):
            primitive = f.item("meshes", mesh)["primitives"][0]
            assert f.item("materials", primitive["material"])["name"] == model.name
            indices, points = f.accessor(primitive["indices"]), f.accessor(primitive["attributes"]["POSITION"])
            stored, given = points[indices.ravel()].reshape(-1, 3, 3), model.mesh.vertices[model.mesh.faces]
            a, b = (x.mean(1)[np.lexsort(x.mean(1).round(4).T)] for x in (stored, given))
            assert np.allclose(a, b, atol=1e-6), "the same triangles, in the order of caches"


def test_a_viewer_that_knows_no_levels_shows_the_finest(files):
    from mi_simplify.formats.load import load_asset

    folder, models = files
    assert load_asset(folder / "lods.glb").n_triangles == models[0].n_triangles


def test_one_usd_layer_refers_to_all_levels(files):
    folder, models = files
    stage = Usd.Stage.Open(str(folder / "lods.usda"))
    root = stage.GetPrimAtPath("/model/levels")
    assert UsdLod.RootAPI(root).GetLodDefaultIndexAttr().Get() == 0
    (heuristic,) = UsdLod.RootAPI(root).GetLodHeuristicsRel().GetTargets()
    thresholds = UsdLod.ScreenSizeHeuristic.Get(stage, heuristic).GetThresholdsAttr().Get()
    assert list(thresholds) == pytest.approx([200 / 1080, 50 / 1080])
    variants = root.GetVariantSets().GetVariantSet("LOD")
    assert variants.GetVariantSelection() == "lod0"

    def triangles() -> list[int]:
        meshes = [p for p in stage.Traverse() if p.GetTypeName() == "Mesh"]
        return [len(p.GetAttribute("faceVertexCounts").Get()) for p in meshes]

    counts = [model.n_triangles for model in models]
    assert triangles() == counts[:1]
    for k, name in enumerate(("lod0", "lod1", "lod2")):
        variants.SetVariantSelection(name)
        assert triangles() == [counts[k]]
    variants.SetVariantSelection("automatic")
    assert triangles() == counts
    assert [child.GetName() for child in root.GetChildren()] == ["lod0", "lod1", "lod2"]


def test_a_chain_from_the_command_line(tmp_path, capsys):
    asset = bumpy_sphere(tmp_path, 16)
    command = ["lod", str(asset), "--triangles", "300,60", "-o", str(tmp_path / "out"), "--quiet", "--usd"]
    command += ["--msft-lod", *(x for s in SHORT for x in ("--set", s))]
    assert cli.main(command) == 0
    chain = json.loads((tmp_path / "out" / "lod.json").read_text())
    fine, coarse = chain["levels"]
    assert fine["screen_size"] is None and fine["target_resolution"] is None and fine["triangles"] <= 300
    assert coarse["triangles"] <= 60 and SIZES[-1] <= coarse["screen_size"] <= SIZES[0]
    assert coarse["flip_above"] and 0 < coarse["screen_share"] <= 1
    assert coarse["target_resolution"] is None or 64 <= coarse["target_resolution"] <= 512
    for level in (fine, coarse):
        assert (tmp_path / "out" / level["file"]).stat().st_size == level["bytes"]
        assert level["psnr"] > 10 and 0 < level["flip"] < 1
    assert (tmp_path / "out" / "lods.glb").exists() and (tmp_path / "out" / "lods.usda").exists()
    assert cli.main(command) == 2 and "already holds a run" in capsys.readouterr().err


def test_a_level_that_looks_like_none_says_so(tmp_path, capsys):
    asset = bumpy_sphere(tmp_path, 16)
    command = [
        "lod",
        str(asset),
        "--triangles",
        "300,40",
        "-o",
        str(tmp_path / "out"),
        "--quiet",
        "--threshold",
        "1e-6",
    ]
    assert cli.main([*command, *(x for s in SHORT for x in ("--set", s))]) == 0
    assert "lod1 never looks like lod0" in capsys.readouterr().err
    coarse = json.loads((tmp_path / "out" / "lod.json").read_text())["levels"][1]
    assert coarse["screen_size"] == SIZES[-1] and coarse["target_resolution"] >= 64


@pytest.mark.parametrize(
    ("triangles", "message"),
    [
        ("300", "at least two budgets"),
        ("60,300", "below the one before"),
        ("20%,150", "below the one before"),
        ("many", "got 'many'"),
    ],
)
def test_wrong_budgets_are_one_line(triangles, message, tmp_path, capsys):
    asset = bumpy_sphere(tmp_path, 15)  # 420 triangles with an area, 450 in all
    assert cli.main(["lod", str(asset), "-n", triangles, "-o", str(tmp_path / "out")]) == 2
    assert message in capsys.readouterr().err and not (tmp_path / "out").exists()
