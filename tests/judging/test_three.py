"""three.js as a judge: it agrees with Mitsuba where both can, reads files itself, and says what it lacks."""

import json
import subprocess
import sys
from contextlib import ExitStack
from dataclasses import replace

import numpy as np
import pytest
from support.models import textured_sphere

from mi_simplify.config.glb import GlbSettings
from mi_simplify.errors import AssetError, RuntimeUnavailable
from mi_simplify.formats.gltf.write import write_glb
from mi_simplify.formats.load import load_asset
from mi_simplify.judging.metrics import compare
from mi_simplify.judging.renderers import PathTraced, opened
from mi_simplify.judging.three.package import three_folder
from mi_simplify.scenes.views import held_out_views


@pytest.fixture(scope="module")
def renderer():
    """Makes renderers of assets that share a page; skips where this machine has no Chromium or no three.js."""
    with ExitStack() as stack:
        try:
            make, _, n = stack.enter_context(opened("three", 16))
        except RuntimeUnavailable as error:
            pytest.skip(str(error))
        assert n == 1, "there is no noise that a second rendering would tell from the difference"
        yield lambda asset: make(asset, np.eye(4))


def test_without_three_js_or_playwright_the_error_says_what_to_install(rejected, monkeypatch, tmp_path):
    write_glb(textured_sphere(), tmp_path / "sphere.glb")
    arguments = ["evaluate", "sphere.glb", "sphere.glb", "--renderer", "three"]
    monkeypatch.setenv("MI_SIMPLIFY_THREE", str(tmp_path / "nowhere"))
    assert "npm install three" in rejected(*arguments)
    package = tmp_path / "three"
    package.mkdir()
    monkeypatch.setenv("MI_SIMPLIFY_THREE", str(package))
    (package / "package.json").write_text("{")
    assert "no whole copy" in rejected(*arguments)
    (package / "package.json").write_text(json.dumps({"version": "0.150.1"}))
    assert "0.152 or newer" in rejected(*arguments)
    (package / "package.json").write_text(json.dumps({"version": "0.170.0"}))
    monkeypatch.setitem(sys.modules, "playwright", None)
    assert "mi-simplify[browser]" in rejected(*arguments)


def test_three_js_is_found_above_the_working_folder(monkeypatch, tmp_path):
    package, deep = tmp_path / "node_modules" / "three", tmp_path / "a" / "b"
    package.mkdir(parents=True)
    deep.mkdir(parents=True)
    (package / "package.json").write_text(json.dumps({"version": "0.170.0"}))
    monkeypatch.delenv("MI_SIMPLIFY_THREE", raising=False)
    monkeypatch.chdir(deep)
    assert three_folder() == package


def test_two_renderers_that_share_nothing_agree(renderer, tmp_path):
    """A convex body has neither shadows nor indirect light, so path tracer and rasteriser show the same."""
    model = textured_sphere()
    specular = model.specular.copy()
    specular[..., 1] = np.maximum(specular[..., 1], 0.6)
    specular[..., 2] = (
        0  # three.js gives rough metal the light that bounces between its facets, glTF's Appendix B does not
    )
    flat = np.tile(np.float32([0, 0, 1]), (*model.normal.shape[:2], 1))
    asset = load_asset(write_glb(replace(model, specular=specular, normal=flat), tmp_path / "sphere.glb"))
    views = held_out_views(asset.bounds, 2, 48)
    path, raster = PathTraced(asset, 64).render(views), renderer(asset).render(views)
    assert np.abs(path[..., 3] - raster[..., 3]).mean() < 0.002, "the same outline"
    inside = (path[..., 3] > 0.999) & (path[..., 1] > 0.1)
    assert inside.mean() > 0.1
    ratio = raster[inside][:, :3].mean(1) / path[inside][:, :3].mean(1)
    assert np.median(ratio) == pytest.approx(1, abs=0.005) and np.abs(ratio - 1).mean() < 0.01


def test_every_packing_is_read_by_three_js_and_other_formats_are_handed_over(renderer, tmp_path):
    model = textured_sphere()
    reference = load_asset(write_glb(model, tmp_path / "plain.glb"))
    views = held_out_views(reference.bounds, 1, 48)
    shown = renderer(reference).render(views)
    packings = {
        "meshopt": GlbSettings(compress="meshopt", textures="webp", quality=100),
        "quantize": GlbSettings(compress="quantize", tangents=False),
    }
    candidates = {
        name: load_asset(write_glb(model, tmp_path / f"{name}.glb", settings=packing))
        for name, packing in packings.items()
    }
    candidates["handed over"] = replace(reference, source="")
    for name, asset in candidates.items():
        figures = compare(shown, renderer(asset).render(views))
        assert figures["psnr"] > (45 if name == "handed over" else 38), name
        assert figures["silhouette_error"] < 0.005, name


def test_a_damaged_file_and_what_cannot_be_handed_over_are_told(renderer, tmp_path):
    asset = load_asset(write_glb(textured_sphere(), tmp_path / "plain.glb"))
    views = held_out_views(asset.bounds, 1, 16)
    (part,) = asset.parts
    colored = replace(asset, source="", parts=(replace(part, colors=np.ones((len(part.vertices), 4), np.float32)),))
    with pytest.raises(AssetError, match="colours of vertices of GLB files only"):
        renderer(colored).render(views)
    (tmp_path / "plain.glb").write_bytes(b"no model any more")
    with pytest.raises(AssetError, match=r"three.js cannot read .*plain.glb"):
        renderer(asset).render(views)


@pytest.mark.slow
def test_evaluate_says_which_renderer_judged(renderer, tmp_path):
    file = str(write_glb(textured_sphere(), tmp_path / "sphere.glb"))
    small = ["--views", "1", "--resolution", "32", "--spp", "1", "-o", str(tmp_path / "out")]
    done = subprocess.run(  # Playwright runs once in a process
        [sys.executable, "-m", "mi_simplify", "evaluate", file, file, "--renderer", "three", *small],
        capture_output=True, text=True, check=True,
    )  # fmt: skip
    assert "judged by three.js" in done.stdout
    assert "three.js" in json.loads((tmp_path / "out" / "metrics.json").read_text())["settings"]["renderer"]
    assert "Rendered by three.js" in (tmp_path / "out" / "report.html").read_text()
