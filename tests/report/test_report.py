"""Pictures, curves, the HTML report, and the project's own judge."""

import base64
import hashlib
import json
import re
import xml.etree.ElementTree as ElementTree
import zlib
from dataclasses import replace
from html.parser import HTMLParser
from pathlib import Path

import numpy as np
import pytest
from jinja2 import UndefinedError
from PIL import Image

from mi_simplify.errors import AssetError, OutputError
from mi_simplify.judging.atlas_use import atlas_use
from mi_simplify.judging.comparison import Comparison, load_comparison, save_comparison
from mi_simplify.judging.evaluate import Judging, compare_assets, evaluate
from mi_simplify.judging.metrics import compare
from mi_simplify.judging.pictures import (
    comparison_columns,
    contact_sheet,
    coverage_errors,
    displayed,
    flip_pictures,
    signed_difference,
)
from mi_simplify.model.asset import Asset, Instance, Material, Part
from mi_simplify.report import gallery
from mi_simplify.report.chart import line_chart, log_ticks, ticks
from mi_simplify.report.folder import report_folder
from mi_simplify.report.gallery import pictures
from mi_simplify.report.html import _cards, report_page, write_report
from mi_simplify.report.templates import render
from mi_simplify.report.viewer import viewer_data
from mi_simplify.scenes.references.mitsuba import MitsubaReference
from mi_simplify.scenes.references.path_traced import make_reference
from mi_simplify.scenes.views import held_out_views


def disc(radius: float, brightness: float = 0.5) -> np.ndarray:
    """Two pictures, 24 x 32, of a grey disc on black."""
    y, x = np.mgrid[:24, :32] - np.array([11.5, 15.5])[:, None, None]
    inside = (x**2 + y**2 < radius**2).astype(np.float32)
    return np.repeat((inside[..., None] * np.float32([brightness] * 3 + [1]))[None], 2, 0)


@pytest.fixture
def comparison() -> Comparison:
    """A reference with two candidates, the second one better."""
    reference, candidates = disc(9), {"first guess": disc(8, 0.4), "result <1>": disc(9, 0.49)}
    figures = {
        "settings": {"spp": 16},
        "reference": {"name": "disc", "triangles": 100_000},
        "candidates": {name: {"triangles": 500, **compare(reference, c)} for name, c in candidates.items()},
        "run": {"notes": []},
    }
    return Comparison(reference, candidates, figures)


# --- pictures -----------------------------------------------------------------------------------------------------


def test_signed_difference_is_red_where_too_bright_and_blue_where_too_dim():
    bright, dim = signed_difference(disc(9), disc(9, 0.9)), signed_difference(disc(9), disc(9, 0.1))
    assert tuple(bright[0, 0, 0]) == tuple(dim[0, 0, 0]) == (128, 128, 128)
    r, _, b = bright[0, 12, 16].astype(int)
    assert r > 200 and b < 60
    r, _, b = dim[0, 12, 16].astype(int)
    assert b > 200 and r < 60


def test_coverage_errors_tell_the_two_sides_apart():
    larger, smaller = coverage_errors(disc(6), disc(9)), coverage_errors(disc(9), disc(6))
    ring = (slice(None), 12, 16 + 7)
    assert larger[ring][0].argmax() == 0 and smaller[ring][0].argmax() == 2  # red, blue
    np.testing.assert_array_equal(larger[0, 12, 16], smaller[0, 12, 16])  # covered by both
    assert np.ptp(larger[0, 12, 16].astype(int)) < 8


def test_flip_pictures_are_dark_where_nothing_is_seen():
    pictures = flip_pictures(disc(9), disc(9))
    assert pictures.shape == (2, 24, 32, 3) and pictures.max() < 10
    assert flip_pictures(disc(9), disc(9, 0.1))[0, 12, 16].max() > 100


def test_contact_sheet_holds_the_pictures(comparison):
    columns = comparison_columns(comparison.reference, comparison.candidates, comparison.per_view)
    names = ["reference", "first guess", "result <1>", "difference", "coverage errors", "FLIP"]
    assert [c.name for c in columns] == names
    sheet = np.asarray(contact_sheet(comparison.reference, comparison.candidates, comparison.per_view))
    enlarged = displayed(comparison.reference)[0].repeat(5, 0).repeat(5, 1)
    windows = np.lib.stride_tricks.sliding_window_view(sheet[:200, :220, 0], enlarged.shape[:2])
    assert (windows == enlarged[..., 0]).all((2, 3)).sum() == 1


# --- curves -------------------------------------------------------------------------------------------------------


def test_ticks_are_round_and_inside():
    assert ticks(0, 700) == [(0, "0"), (200, "200"), (400, "400"), (600, "600")]
    assert [t for _, t in ticks(26.2, 34.1)] == ["28", "30", "32", "34"]
    assert [t for _, t in log_ticks(-2, 1)] == ["0.01", "0.1", "1", "10"]
    assert [t for _, t in log_ticks(-1.8, -0.5)] == ["0.02", "0.05", "0.1", "0.2"]
    assert [t for _, t in log_ticks(np.log10(0.00587), np.log10(0.0063))] == [
        "0.0059",
        "0.006",
        "0.0061",
        "0.0062",
        "0.0063",
    ]


@pytest.mark.parametrize("n", [1, 2, 1000])
def test_chart_is_well_formed_and_inside_its_frame(n):
    y = 10.0 ** -np.linspace(0, 3, n)
    root = ElementTree.fromstring(line_chart(np.arange(n), y, x_label="step", y_label="loss", log=True))
    line = next(e for e in root if e.tag == "polyline").attrib["points"]
    points = np.array([p.split(",") for p in line.split()], float)
    assert len(points) <= 401
    width, height = (float(v) for v in root.attrib["viewBox"].split()[2:])
    assert (points >= 0).all() and (points[:, 0] <= width).all() and (points[:, 1] <= height).all()
    assert (np.diff(points[:, 1]) >= 0).all(), "a falling curve falls on the page"


def test_chart_leaves_out_what_cannot_be_drawn():
    assert line_chart([1, 2], [np.nan, -1.0], x_label="step", y_label="loss", log=True) == ""
    assert "nan" not in line_chart([1, 2, 3], [1.0, np.nan, 2.0], x_label="step", y_label="loss")


# --- HTML ---------------------------------------------------------------------------------------------------------


class Page(HTMLParser):
    """Pictures, section ids and references of a page, and whether its elements close."""

    VOID = {"meta", "img", "br", "link", "input"}

    def __init__(self, text: str) -> None:
        super().__init__()
        self.images, self.sections, self.links, self.scripts, self.open = [], [], [], [], []
        self.feed(text)

    def handle_starttag(self, tag, attrs):
        attrs = dict(attrs)
        if tag not in self.VOID:
            self.open.append(tag)
        if tag == "img":
            self.images.append(attrs)
        if tag == "section":
            self.sections.append(attrs["id"])
        if tag == "script":
            self.scripts.append(attrs.get("type"))
        self.links += [v for k, v in attrs.items() if k in ("src", "href") and not v.startswith("data:")]

    def handle_startendtag(self, tag, attrs):
        pass

    def handle_endtag(self, tag):
        assert self.open.pop() == tag


def texture_set(**settings) -> Material:
    """A material with noise in every texture."""
    rng = np.random.default_rng(0)
    normal = np.zeros((9, 30, 3)) + [0, 0, 1]
    return Material("paint", *(rng.random((9, 30, n), np.float32) for n in (4, 3)), normal=normal, **settings)


def test_report_is_one_well_formed_file(comparison, tmp_path):
    part = replace(octahedron().parts[0], material=texture_set(alpha_mode="MASK"))
    log = [
        {"step": k, "loss": 1 / k, "seconds": 0.5 * k} | ({"psnr": 30.0 + k} if k % 5 == 0 else {})
        for k in range(1, 99)
    ]
    path = write_report(
        tmp_path / "report.html",
        comparison,
        title="</title><script>alert(1)</script>",
        summary="a & b",
        models={"reference": octahedron(), "</script>": Asset((part,), (Instance(0),))},
        settings="asset: <spot>.obj",
        log=log,
        files=[tmp_path / "missing.glb", __file__],
        notes=["<img src=x onerror=alert(1)>"],
    )
    text = path.read_text(encoding="utf-8")
    page = Page(text)
    assert not page.open and not page.links
    sections = ["summary", "side-by-side", "model", "views", "textures", "figures", "curves", "notes", "files"]
    assert page.sections == [*sections, "settings"]
    pictures = [image for image in page.images if image.get("src")]
    assert len(pictures) == 2 * (3 + 2 * 3) + 6, "views, and base colour, opacity, gamma, roughness, metal, normal"
    assert all(image["src"].startswith("data:image/webp;base64,") for image in pictures)
    assert page.scripts == ["application/json"] * 2 + [None] * 2
    assert "<script>alert" not in text and "&lt;spot&gt;.obj" in text and "49 s" in text
    (data,) = re.findall(r'id="report-data">(.*?)</script>', text)
    assert json.loads(data) == comparison.figures
    assert text.count("<svg class=") == 2


def test_every_text_of_a_report_is_escaped(comparison, tmp_path):
    evil = "\"'><script>alert(1)</script>"
    (tmp_path / "a<script>alert(1).txt").write_text("x")
    materials = [replace(texture_set(), name=evil + str(k)) for k in range(2)]
    parts = tuple(replace(octahedron().parts[0], material=material) for material in materials)
    rows = comparison.figures["candidates"].values()
    names = [evil + "1", evil + "2"]
    hostile = Comparison(
        comparison.reference,
        dict(zip(names, comparison.candidates.values(), strict=True)),
        comparison.figures | {"candidates": dict(zip(names, rows, strict=True)), "run": {"notes": [evil]}},
    )
    text = report_page(
        hostile, title=evil, summary=evil, models={evil: Asset(parts, (Instance(0), Instance(1)))}, settings=evil,
        maps={evil: np.zeros((2, 2), np.uint8)}, notes=[evil], files=list(tmp_path.glob("*.txt")),
    )  # fmt: skip
    page = Page(text)
    assert not page.open and not page.links and page.scripts == ["application/json"] * 2 + [None] * 2
    assert "<script>alert" not in text
    labels = [image["alt"] for image in page.images if image.get("src")]
    assert f"{evil}2, view 1" in labels and f"{evil}0: base colour" in labels and evil in labels, "as they were"


def test_a_template_that_asks_for_what_is_missing_is_a_defect():
    with pytest.raises(UndefinedError, match="css"):
        render("chart.svg")


def test_a_page_runs_its_own_scripts_only(comparison, tmp_path):
    text = write_report(tmp_path / "r.html", comparison, title="t", models={"a": octahedron()}).read_text("utf-8")
    (policy,) = re.findall(r'Content-Security-Policy" content="(.*?)"', text)
    scripts = re.findall(r"<script>(.*?)</script>", text, re.DOTALL)
    hashes = [base64.b64encode(hashlib.sha256(script.encode()).digest()).decode() for script in scripts]
    assert policy.startswith("default-src 'none'; img-src data:;")
    assert policy.partition("script-src ")[2].split() == [f"'sha256-{h}'" for h in hashes] and len(hashes) == 2


def test_report_needs_no_more_than_a_comparison(comparison, tmp_path):
    page = Page(write_report(tmp_path / "report.html", comparison, title="disc").read_text(encoding="utf-8"))
    assert page.sections == ["summary", "side-by-side", "views", "figures"]
    assert page.scripts == ["application/json", None]
    del comparison.figures["run"]  # candidates of equal rank: all of them first, none as the result
    page = Page(write_report(tmp_path / "report.html", comparison, title="disc").read_text(encoding="utf-8"))
    assert page.sections == ["figures", "side-by-side", "views"]


def test_the_frames_of_a_character_are_told(comparison, tmp_path):
    shown = replace(comparison, figures=comparison.figures | {"settings": {"spp": 16, "frames": [1.0, 12.5]}})
    text = write_report(tmp_path / "report.html", shown, title="disc").read_text(encoding="utf-8")
    assert "The views are of frames 1, 12.5." in text


def test_the_grid_shows_the_errors_of_the_last_candidate_first(comparison, tmp_path):
    text = write_report(tmp_path / "report.html", comparison, title="disc").read_text(encoding="utf-8")
    cell = r'<figure data-view="0" data-index="\d" data-column="(.*?)"(?: data-of="(.*?)")?( hidden)?>'
    first, result, errors = "first guess", "result &lt;1&gt;", ("difference", "coverage errors", "FLIP")
    expected = [(name, "", "") for name in ("reference", first, result)]
    expected += [(e, first, " hidden") for e in errors] + [(e, result, "") for e in errors]
    assert re.findall(cell, text) == expected


def test_pictures_are_cut_to_what_is_seen_and_are_never_too_many(comparison, monkeypatch):
    columns = pictures(comparison)
    assert columns[0].images.shape == (2, 20, 20, 3), "a disc of radius 9 with a margin in 24 x 32"
    np.testing.assert_array_equal(columns[1].images, displayed(comparison.candidates["first guess"])[:, 2:22, 6:26])
    monkeypatch.setattr(gallery, "MOST_PIXELS", 9 * 2 * 10 * 10)
    assert {column.images.shape for column in pictures(comparison)} == {(2, 10, 10, 3)}
    monkeypatch.setattr(gallery, "MOST_VIEWS", 1)
    assert len(pictures(comparison)[0].images) == 1
    assert gallery.left_out(comparison) == " The first 1 of 2 views are shown."


def test_viewer_data_is_the_model(comparison):
    part = replace(octahedron().parts[0], material=texture_set())
    twice = Asset((part,), (Instance(0), Instance(0, np.diag([-1.0, 1, 1, 1]) + np.eye(4, k=3) * 5e6)))
    data = viewer_data({"first": octahedron(), "twice": twice})
    first, model = data["models"]
    assert (first["triangles"], model["triangles"]) == (8, 16)
    assert first["parts"][0]["textures"]["roughness"].startswith("data:image/webp")
    (joined,) = model["parts"]  # one material, one draw call
    assert joined["textures"]["normal"] == "#texture-0-normal" and "opacity" not in joined["textures"]

    def unpacked(name, dtype, width):
        return np.frombuffer(zlib.decompress(base64.b64decode(joined[name])), dtype).reshape(-1, width)

    positions, faces = unpacked("positions", "<f4", 3), unpacked("indices", "<u2", 3)
    expected = np.concatenate([p.vertices[p.faces] for p in twice.placed()])
    low, high = twice.bounds
    radius = np.linalg.norm(high - low) / 2
    np.testing.assert_allclose(positions[faces], (expected - (low + high) / 2) / radius, atol=1e-6)
    normals, tangents = (unpacked(name, "<i2", 4)[:, :3] / 32767 for name in ("normals", "tangents"))
    np.testing.assert_allclose(np.linalg.norm(normals, axis=1), 1, atol=1e-3)
    assert np.abs((normals * tangents).sum(1)).max() < 1e-3
    outward = np.cross(*(positions[faces][:, k] - positions[faces][:, 0] for k in (1, 2)))
    assert ((outward * normals[faces[:, 0]]).sum(1) > 0).all(), "the mirrored one is wound as its normals say"


# --- folders ------------------------------------------------------------------------------------------------------


@pytest.fixture
def judged(comparison, tmp_path) -> Path:
    """A folder as a comparison leaves it."""
    save_comparison(comparison, tmp_path / "out")
    return tmp_path / "out"


def test_what_is_saved_comes_back_as_a_screen_shows_it(comparison, judged):
    loaded = load_comparison(judged)
    assert loaded.figures == comparison.figures and list(loaded.candidates) == list(comparison.candidates)
    np.testing.assert_array_equal(displayed(loaded.reference), displayed(comparison.reference))
    half = np.full((1, 2, 2, 4), 0.5, np.float32)
    figures = {**comparison.figures, "candidates": {"a": {"triangles": 1, **compare(half, half)}}}
    save_comparison(Comparison(half, {"a": half}, figures), judged)
    assert not (load_comparison(judged).reference[..., 3] > 0.5).any(), "half covered is not covered"


def test_a_report_is_built_from_a_folder_alone(judged):
    (judged / "config.yaml").write_text("asset: my.obj\n")
    (judged / "log.jsonl").write_text("".join(f'{{"step": {k}, "loss": {1 / k}, "psnr": null}}\n' for k in (1, 11, 21)))
    text = report_folder(judged).read_text(encoding="utf-8")
    page = Page(text)
    assert page.sections == ["summary", "side-by-side", "views", "figures", "curves", "settings"]
    assert "asset: my.obj" in text and "<h1>disc</h1>" in text
    assert report_folder(judged).read_text(encoding="utf-8") == text


def test_candidates_are_called_by_what_tells_their_files_apart(comparison, tmp_path):
    a, b = (f"/deep/folder/{k}/model.glb" for k in "ab")
    for names, expected in (((a, b), ["a/model.glb", "b/model.glb"]), ((a,), ["model.glb"])):
        rows = dict(zip(names, comparison.figures["candidates"].values(), strict=False))
        images = dict(zip(names, comparison.candidates.values(), strict=False))
        save_comparison(Comparison(comparison.reference, images, comparison.figures | {"candidates": rows}), tmp_path)
        text = report_folder(tmp_path).read_text(encoding="utf-8")
        (data,) = re.findall(r'id="report-data">(.*?)</script>', text)
        assert list(json.loads(data)["candidates"]) == expected
        assert "/deep/folder" not in text


def test_a_line_that_was_cut_off_is_left_out_of_the_curves(judged, caplog):
    (judged / "log.jsonl").write_text('{"step": 1, "loss": 1.0}\n{"step": 11, "loss": 0.5}\n{"step": 2')
    assert "curves" in Page(report_folder(judged).read_text(encoding="utf-8")).sections
    assert "log.jsonl, line 3 is damaged" in caplog.text


@pytest.mark.parametrize(
    ("name", "content", "message"),
    [
        ("metrics.json", None, "holds no finished run; name a folder"),
        ("metrics.json", b"{", "metrics.json is damaged"),
        ("metrics.json", b'{"candidates": {"a": 3}, "reference": {}}', "metrics.json is damaged"),
        ("views.npz", None, "has no views.npz"),
        ("views.npz", b"PK\x03\x04nothing", "views.npz is damaged"),
        ("views.npz", b"", "views.npz is damaged"),
        ("config.yaml", b"\xff\xfe", "config.yaml is damaged"),
        ("displacement/displacement.json", b"{}", "displacement is damaged"),
    ],
)
def test_a_damaged_folder_is_one_line(judged, name, content, message):
    (judged / name).unlink(missing_ok=True)
    if content is not None:
        (judged / name).parent.mkdir(exist_ok=True)
        (judged / name).write_bytes(content)
    with pytest.raises(OutputError, match=message) as error:
        report_folder(judged)
    assert "\n" not in str(error.value)


def test_pictures_of_other_figures_are_refused(judged):
    with np.load(judged / "views.npz") as archive:
        arrays = dict(archive)
    for wrong in (arrays["reference"][:1], arrays["reference"][:, :5], arrays["reference"].astype(np.float32)):
        np.savez(judged / "views.npz", **(arrays | {"candidate_0": wrong}))
        with pytest.raises(OutputError, match=r"damaged|does not belong"):
            report_folder(judged)


@pytest.mark.parametrize(("settings", "said"), [({"sky": 0.1}, "has not seen"), ({}, "in the light of the fit")])
def test_the_page_says_which_light_its_pictures_have(comparison, settings, said):
    figures = comparison.figures | {"settings": comparison.figures["settings"] | settings}
    assert said in report_page(replace(comparison, figures=figures), title="disc")


# --- evaluate -----------------------------------------------------------------------------------------------------


def octahedron(scale: float = 1.0, color: float = 0.5) -> Asset:
    """A small closed asset."""
    vertices = np.array([[1, 0, 0], [-1, 0, 0], [0, 1, 0], [0, -1, 0], [0, 0, 1], [0, 0, -1]], float) * scale
    faces = [[0, 2, 4], [2, 1, 4], [1, 3, 4], [3, 0, 4], [2, 0, 5], [1, 2, 5], [3, 1, 5], [0, 3, 5]]
    material = Material(base_color=np.float32([[[color, color, color, 1]]]))
    return Asset((Part(vertices, np.array(faces), material=material),), (Instance(0),), name="octahedron")


def test_evaluate_ranks_candidates_and_writes_its_files(tmp_path):
    told = []
    candidates = {"same": octahedron(), "dark": octahedron(color=0.4), "small": octahedron(0.9)}
    settings = dict(n_views=3, resolution=48, spp=16, seed=4)
    figures = evaluate(octahedron(), candidates, **settings, out=tmp_path / "out", progress=told.append)
    by_name = figures["candidates"]
    assert by_name["same"]["psnr"] > 50 and by_name["same"]["silhouette_error"] == 0, "the same noise on both sides"
    assert by_name["dark"]["silhouette_error"] == 0 and by_name["dark"]["flip"] > by_name["same"]["flip"]
    assert by_name["small"]["silhouette_error"] == pytest.approx(1 - 0.81, abs=0.06)
    assert by_name["small"]["psnr"] < by_name["dark"]["psnr"]
    assert json.loads((tmp_path / "out" / "metrics.json").read_text()) == figures
    assert np.asarray(Image.open(tmp_path / "out" / "contact_sheet.png")).shape[1] > 8 * 48
    assert [(p.step, p.n_steps) for p in told] == [(k, 12) for k in range(1, 13)]
    assert figures["reference"]["triangles"] == 8 and figures["settings"]["seed"] == 4


def test_one_seed_gives_the_same_images_again():
    settings = dict(n_views=2, resolution=48, spp=16)
    a, b, c = (compare_assets(octahedron(), {}, Judging(**settings, seed=seed)).reference for seed in (0, 0, 1))
    np.testing.assert_array_equal(a, b)
    assert not np.array_equal(a, c), "another seed, other views"
    lit = a[a[..., 3] == 1][:, :3]
    assert np.isfinite(lit).all() and 0.02 < lit.mean() < 1


def test_light_and_sky_add_up_though_only_the_light_is_picked():
    """In one rendering as apart, and with both to pick from; but there is less noise than in that."""
    asset = octahedron()
    views = held_out_views(asset.bounds, 2, 48, 0)

    def rendered(sky, spp, share=None, dark=False):
        reference = make_reference(asset, transport="baked", spp=spp, max_depth=6, sky=sky)
        assert isinstance(reference, MitsubaReference)
        if share is not None:
            reference.shapes["sky"]["sampling_weight"] = share
        return reference.render(views.lit_by(0.0) if dark else views, seed=9)[..., :3]

    judged = compare_assets(asset, {}, Judging(n_views=2, resolution=48, spp=64)).reference[..., :3]
    both = rendered(0.1, 256, share=1.0)
    apart = rendered(0.0, 64) + rendered(0.1, 64, share=1.0, dark=True)
    assert judged.mean() == pytest.approx(both.mean(), rel=0.01) == pytest.approx(apart.mean(), rel=0.01)
    noise = [np.abs(rendered(0.1, 16, share) - both).mean() for share in (None, 1.0)]
    assert noise[0] < 0.7 * noise[1]


def test_evaluate_of_an_invisible_reference_is_an_error():
    part = octahedron().parts[0]
    clear = Material(base_color=np.zeros((1, 1, 4), np.float32), alpha_mode="BLEND")
    ghost = Asset((replace(part, material=clear),), (Instance(0),), name="ghost")
    with pytest.raises(AssetError, match="ghost: no held-out view shows anything"):
        evaluate(ghost, {"same": ghost}, n_views=1, resolution=16, spp=2)


def test_an_unwritable_folder_is_found_before_rendering(tmp_path):
    (tmp_path / "file").write_text("")
    told = []
    with pytest.raises(OutputError, match="cannot write"):
        evaluate(octahedron(), {"same": octahedron()}, out=tmp_path / "file", progress=told.append)
    assert not told


def test_costs_stand_beside_the_assets_in_green_or_red():
    reference, result = (
        {"vertices": v, "charts": 3, "fill": f, "texels": 16, "bytes": b, "triangles": 9}
        for v, f, b in ((100, 0.5, 5000), (40, 0.7, 7000))
    )
    row = result | {"psnr": 30.0, "flip": 0.1, "silhouette_error": 0.01}
    cards = {card["name"]: card for card in _cards({"reference": reference, "candidates": {"result": row}}, [])}
    assert [cards[name]["verdict"] for name in ("vertices", "charts", "atlas filled", "texels", "file")] == [
        "good", "same", "good", "same", "bad",
    ]  # fmt: skip
    assert (cards["atlas filled"]["value"], cards["atlas filled"]["note"]) == ("70%", "asset: 50%")
    assert (cards["file"]["value"], cards["file"]["note"]) == ("7.0 kB", "asset: 5.0 kB")


def test_charts_and_fill_of_a_model():
    quad = np.array([[0, 1, 2], [0, 2, 3]])
    corners = np.array([[0.0, 0], [1, 0], [1, 1], [0, 1]])
    part = Part(np.pad(corners, ((0, 0), (0, 1))), quad, uvs=np.float32(0.5 * corners), material=texture_set())
    apart = replace(part, uvs=np.float32(0.5 * corners + 0.5))
    near = pytest.approx  # a centre on an edge between two triangles counts for neither
    assert atlas_use([part]) == {"charts": 1, "fill": near(0.25, abs=2e-3)}
    assert atlas_use([part, apart]) == {"charts": 2, "fill": near(0.5, abs=4e-3)}, "in one place of space alone"
    doubled = replace(part, vertices=part.vertices[quad.ravel()], uvs=part.uvs[quad.ravel()])
    doubled = replace(doubled, faces=np.arange(6).reshape(2, 3))
    assert atlas_use([doubled])["charts"] == 1, "vertices of a file may be split without a seam"
    assert atlas_use([replace(part, uvs=np.float32(3 * corners))]) == {"charts": 1, "fill": None}, "it repeats"
    assert atlas_use([replace(part, uvs=None)]) == {"charts": None, "fill": None}
