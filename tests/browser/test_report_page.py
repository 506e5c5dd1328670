"""The report in headless Chromium: nothing fails, nothing is fetched, the divider moves, the model is drawn."""

import io
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from mi_simplify.judging.comparison import Comparison
from mi_simplify.judging.metrics import compare
from mi_simplify.model.asset import Asset, Instance, Material, Part
from mi_simplify.model.rig import Rig, Skin
from mi_simplify.report.html import write_report

RED, GREEN = [0.8, 0.05, 0.05, 1.0], [0.05, 0.6, 0.05, 1.0]


def sphere(n: int, color: list[float], opacity: float = 1.0) -> Asset:
    """A UV sphere of radius 1 with textures, half of it see-through where ``opacity`` is 0."""
    v, u = np.meshgrid(np.linspace(0, 1, n + 1), np.linspace(0, 1, 2 * n + 1), indexing="ij")
    theta, phi = np.pi * v.ravel(), 2 * np.pi * u.ravel()
    p = np.stack([np.sin(theta) * np.sin(phi), np.cos(theta), np.sin(theta) * np.cos(phi)], 1)
    a = (np.arange(n)[:, None] * (2 * n + 1) + np.arange(2 * n)).ravel()
    faces = np.concatenate([np.stack([a, a + 2 * n + 1, a + 1], 1), np.stack([a + 1, a + 2 * n + 1, a + 2 * n + 2], 1)])
    base = np.tile(np.float32(color), (8, 8, 1))
    base[4:, :, 3] = opacity
    material = Material(
        base_color=base, specular=np.tile(np.float32([0, 0.4, 0]), (8, 8, 1)),
        normal=np.tile(np.float32([0, 0, 1]), (8, 8, 1)), alpha_mode="OPAQUE" if opacity == 1 else "MASK",
    )  # fmt: skip
    uvs = np.stack([u.ravel(), v.ravel()], 1).astype(np.float32)
    return Asset((Part(p, faces, p.astype(np.float32), uvs, material=material),), (Instance(0),), name="sphere")


def discs(brightness: float) -> np.ndarray:
    """Two pictures of 48² with a disc, smaller in the second one."""
    y, x = np.mgrid[:48, :48] - 23.5
    inside = np.stack([x**2 + y**2 < r**2 for r in (20, 12)]).astype(np.float32)
    return inside[..., None] * np.float32([brightness] * 3 + [1])


def comparison() -> Comparison:
    """A reference with two candidates, the second one better."""
    reference, candidates = discs(0.9), {"first guess": discs(0.1), "result <b>": discs(0.85)}
    figures = {
        "settings": {"spp": 4},
        "reference": {"name": "sphere", "triangles": 1600},
        "candidates": {name: {"triangles": 200, **compare(reference, c)} for name, c in candidates.items()},
        "run": {},
    }
    return Comparison(reference, candidates, figures)


@pytest.fixture(scope="module")
def report(tmp_path_factory) -> Path:
    """A report of a made-up run over two spheres."""
    return write_report(
        tmp_path_factory.mktemp("report") / "report.html", comparison(), title="sphere",
        models={"reference": sphere(20, RED), "result <b>": sphere(8, GREEN, opacity=0.0)}, settings="asset: sphere",
        log=[{"step": k, "loss": 1 / k, "psnr": 20 + k} for k in range(1, 9)], notes=["a note"],
    )  # fmt: skip


@pytest.fixture
def opened(browser, report) -> Iterator:
    """The report on a laptop; whatever it complains of or asks for fails the test."""
    yield from page_of(browser, report, width=1366, height=768)


def page_of(browser, report: Path, *, width: int, height: int, **options) -> Iterator:
    """A page that shows the report, closed and judged afterwards."""
    context = browser.new_context(viewport={"width": width, "height": height}, reduced_motion="reduce", **options)
    page, troubles, requests = context.new_page(), [], []
    page.on("console", lambda message: troubles.append(message.text))
    page.on("pageerror", lambda error: troubles.append(str(error)))
    page.on("request", lambda request: requests.append(request.url))
    page.goto(report.as_uri())
    yield page
    assert not troubles
    assert {url for url in requests if not url.startswith(("data:", "blob:"))} == {report.as_uri()}
    context.close()


def picture(locator) -> np.ndarray:
    """What the browser shows of an element, shape (H, W, 3)."""
    return np.asarray(Image.open(io.BytesIO(locator.screenshot())).convert("RGB")).astype(float)


def drawn(page) -> np.ndarray:
    """The picture of the model, once it is there."""
    page.locator("#viewer").scroll_into_view_if_needed()
    page.wait_for_selector("#viewer[data-state=drawn]")
    page.evaluate("new Promise((done) => requestAnimationFrame(() => requestAnimationFrame(done)))")
    return picture(page.locator("#viewer canvas"))


def test_all_pictures_load(opened):
    images = "[...document.images].filter((i) => i.getAttribute('src'))"
    opened.evaluate(f"Promise.all({images}.map((i) => i.decode()))")
    assert opened.evaluate(f"{images}.every((i) => i.naturalWidth > 0)")
    assert opened.evaluate(f"{images}.length") == 2 * (3 + 6) + 2 + 2 + 5, "grid, divider, views to choose, textures"
    assert opened.locator("svg.curve").count() == 2


def test_the_divider_follows_pointer_and_keys(opened):
    stage = opened.locator("#stage")
    box = stage.bounding_box()
    value = lambda: int(stage.get_attribute("aria-valuenow"))  # noqa: E731
    assert value() == 50
    middle = box["y"] + box["height"] / 2
    opened.mouse.move(box["x"] + box["width"] / 2, middle)
    opened.mouse.down()
    opened.mouse.move(box["x"] + 0.8 * box["width"], middle, steps=4)
    assert value() == 80
    opened.mouse.up()
    opened.mouse.move(box["x"], middle)
    assert value() == 80, "let go"
    stage.press("ArrowLeft")
    assert value() == 78
    stage.press("Home")
    assert value() == 0
    stage.press("End")
    assert value() == 100


def test_the_divider_parts_the_two_pictures_that_are_chosen(opened):
    opened.select_option("select[data-side=right]", label="first guess")
    stage = opened.locator("#stage")
    at = lambda image, x: image[int(0.35 * len(image)), int(x * image.shape[1])].mean()  # noqa: E731
    halves = picture(stage)
    assert at(halves, 0.35) > 180 and at(halves, 0.65) < 120, "bright reference, dark first guess"
    stage.press("End")
    assert at(picture(stage), 0.65) > 180
    opened.select_option("select[data-side=left]", label="result <b>: difference")
    np.testing.assert_allclose(picture(stage)[5, 5], 128, atol=2)


def test_another_view_is_chosen_by_button_or_key(opened):
    source = lambda: opened.locator("#stage img.left").get_attribute("src")  # noqa: E731
    first = source()
    opened.locator(".thumbs button").nth(1).click()
    second = source()
    assert second != first
    opened.locator("#stage").press("ArrowUp")
    assert source() == first
    opened.locator("#stage").press("ArrowUp")
    assert source() == second, "from the first to the last"
    assert opened.locator(".thumbs button[aria-current=true]").count() == 1


def test_the_grid_shows_the_errors_that_are_chosen(opened):
    seen = "[...document.querySelectorAll('.views figure:not([hidden])')].map((f) => f.dataset.of).filter(Boolean)"
    assert set(opened.evaluate(seen)) == {"result <b>"}
    opened.select_option("#errors-of", label="first guess")
    assert set(opened.evaluate(seen)) == {"first guess"}
    assert len(opened.evaluate(seen)) == 2 * 3


def test_the_model_is_drawn_and_turns(opened):
    before = drawn(opened)
    height, width = before.shape[:2]
    centre = before[height // 2 - 60 : height // 2 - 20, width // 2 - 20 : width // 2 + 20].mean((0, 1))
    assert centre[1] > 1.5 * centre[0] and centre[1] > 60, "green"
    assert np.ptp(before[5, 5]) < 20 and before[5, 5].max() < 60, "background"
    box = opened.locator("#viewer canvas").bounding_box()
    opened.mouse.move(box["x"] + width / 2, box["y"] + height / 2)
    opened.mouse.down()
    opened.mouse.move(box["x"] + width / 2, box["y"] + height / 2 + 150, steps=3)
    opened.mouse.up()
    turned = drawn(opened)
    assert np.abs(turned - before).mean() > 1
    opened.mouse.wheel(0, -400)
    closer = drawn(opened)
    covered = lambda image: (image[..., 1] > image[..., 0] + 20).mean()  # noqa: E731
    assert covered(closer) > 1.2 * covered(turned) > 0.05


def test_opacity_cuts_the_model_and_the_other_model_is_whole(opened):
    half = drawn(opened)
    opened.select_option("#viewer select[name=model]", index=0)
    opened.wait_for_timeout(200)
    whole = drawn(opened)
    green = (half[..., 1] > half[..., 0] + 20).mean()
    red = (whole[..., 0] > whole[..., 1] + 20).mean()
    assert red > 1.3 * green > 0.05
    opened.check("#viewer input[name=wires]")
    wired = drawn(opened)
    assert ((wired[..., 1] > 150) & (wired[..., 0] < 100)).mean() > 0.005


def test_what_is_shown_of_the_model_can_be_chosen(opened):
    middle = lambda image: image[image.shape[0] // 2 - 40, image.shape[1] // 2]  # noqa: E731
    opened.select_option("#viewer select[name=model]", index=0)
    opened.wait_for_timeout(200)
    shown = {}
    for mode in ("base colour", "roughness", "metallic", "shape alone"):
        opened.select_option("#viewer select[name=mode]", label=mode)
        shown[mode] = middle(drawn(opened))
    np.testing.assert_allclose(shown["base colour"] / 255, np.array(RED[:3]) ** (1 / 2.2), atol=0.03)
    np.testing.assert_allclose(shown["roughness"], 0.4 * 255, atol=3)
    np.testing.assert_allclose(shown["metallic"], 0, atol=3)
    assert np.ptp(shown["shape alone"]) < 6, "grey"


def test_normal_maps_lean_the_way_that_they_say(browser, tmp_path):
    flat = sphere(20, RED)
    (part,) = flat.parts
    lean = np.tile(np.float32([0.4, 0.4, 0.824]), (8, 8, 1))
    leaning = replace(part, material=replace(part.material, normal=lean))
    mirrored = replace(leaning, uvs=np.float32([1, 0]) + np.float32([-1, 1]) * part.uvs)
    models = {"flat": flat} | {f"{k}": Asset((p,), (Instance(0),)) for k, p in enumerate((leaning, mirrored))}
    report = write_report(tmp_path / "report.html", comparison(), title="sphere", models=models)
    seen = []
    for page in page_of(browser, report, width=1366, height=768):
        page.select_option("#viewer select[name=mode]", label="normals")
        for k in range(3):
            page.select_option("#viewer select[name=model]", index=k)
            page.wait_for_timeout(200)
            image = drawn(page)
            seen.append(image[image.shape[0] // 2, image.shape[1] // 2] / 255 * 2 - 1)
    normal, right = np.array([0.54, 0.296, 0.789]), np.array([0.825, 0, -0.565])  # where the camera looks from
    np.testing.assert_allclose(seen[0], normal, atol=0.06)
    along = [[(x - seen[0]) @ axis for axis in (right, np.cross(normal, right))] for x in seen[1:]]
    np.testing.assert_allclose(along, [[0.4, 0.4], [-0.4, 0.4]], atol=0.08)


def test_a_texture_is_enlarged_and_put_back(opened):
    dialog = opened.locator("#enlarged")
    assert not dialog.is_visible()
    opened.locator("[data-texture=roughness] img.zoom").click()
    assert dialog.is_visible()
    assert dialog.locator("p").inner_text() == "roughness, 8 × 8"
    assert dialog.locator("img").first.bounding_box()["width"] > 500
    dialog.click()
    assert not dialog.is_visible()
    opened.locator("[data-texture=normal] img.zoom").press("Enter")
    assert dialog.is_visible()
    opened.keyboard.press("Escape")
    assert not dialog.is_visible()


@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_nothing_is_wider_than_a_phone_and_fingers_work(browser, report, scheme):
    for page in page_of(browser, report, width=390, height=844, color_scheme=scheme, has_touch=True):
        assert page.evaluate("document.documentElement.scrollWidth") == 390
        paper = page.evaluate("getComputedStyle(document.body).backgroundColor")
        assert (int(paper.split("(")[1].split(",")[0]) > 128) == (scheme == "light")
        stage = page.locator("#stage")
        stage.scroll_into_view_if_needed()
        box = stage.bounding_box()
        page.touchscreen.tap(box["x"] + 0.25 * box["width"], box["y"] + box["height"] / 2)
        assert int(stage.get_attribute("aria-valuenow")) == pytest.approx(25, abs=1)
        assert drawn(page).std() > 5


def test_without_webgl_it_says_so(browser, report):
    blind = "HTMLCanvasElement.prototype.getContext = () => null"
    context = browser.new_context()
    page = context.new_page()
    page.add_init_script(blind)
    page.goto(report.as_uri())
    assert page.locator("#viewer .none").is_visible() and not page.locator("#viewer canvas").is_visible()
    context.close()


def moving_sphere() -> Asset:
    """A sphere that one joint carries, and a skin half of which follows another: to the right, in two clips."""
    ball = sphere(12, GREEN)
    part, n = ball.parts[0], len(ball.parts[0].vertices)
    skin = Skin(np.tile([0, 1], (n, 1)), np.full((n, 2), 0.5))
    poses = np.tile(np.eye(4), (5, 2, 1, 1))
    poses[2:, :, 0, 3] = [[0, 0], [1.5, 0.5], [4, 0]]  # the mean of both joints is how far the skin goes
    rig = Rig(
        ("a", "b"), np.array([-1, 0]), np.tile(np.eye(4), (2, 1, 1)), poses, np.arange(5.0), rate=10.0,
        clips=(("stand", 0, 2), ("walk", 2, 5)),
    )  # fmt: skip
    return Asset((replace(part, skin=skin),), (Instance(0),), name="moving", rig=rig)


def test_a_clip_plays_stops_and_goes_to_a_frame(browser, tmp_path):
    models = {"still": sphere(8, RED), "moving": moving_sphere()}
    report = write_report(tmp_path / "report.html", comparison(), title="sphere", models=models)
    for page in page_of(browser, report, width=1366, height=768):
        slider, play = page.locator("#viewer [name=frame]"), page.locator("#viewer [name=play]")
        assert not play.is_checked(), "as whoever wants less motion asks"
        middles = []
        page.select_option("#viewer [name=clip]", label="walk")
        assert slider.get_attribute("max") == "4"
        for frame in (2, 3, 4):
            slider.fill(str(frame))
            green = drawn(page)
            x = np.nonzero(green[..., 1] > green[..., 0] + 20)[1]
            middles.append((x.min() + x.max()) / 2)
        steps = np.diff(middles)
        assert steps[0] > 30 and steps[1] / steps[0] == pytest.approx(1, abs=0.25), "1 each, but perspective"
        assert page.locator("#viewer output").inner_text() == "3 of 3, 0.20 s"
        play.check()
        page.wait_for_selector("#viewer:not([data-frame='4'])")
        slider.fill("3")
        assert not play.is_checked()


def test_a_model_that_does_not_move_has_no_clip(opened):
    assert opened.locator("#viewer [name=play]").count() == 0


def test_the_uv_layout_lies_over_the_textures(opened):
    layouts = opened.locator("img.layout[data-part]")
    assert layouts.count() == 5 and not layouts.first.is_visible()
    before = picture(opened.locator("[data-texture=roughness] .sheet"))
    opened.check("#layout")
    opened.wait_for_selector(".textures figure:last-child img.layout[src]", state="attached")
    opened.evaluate("Promise.all([...document.querySelectorAll('img.layout[data-part]')].map((i) => i.decode()))")
    after = picture(opened.locator("[data-texture=roughness] .sheet"))
    lines = np.abs(after - before).max(2) > 40
    row = lines[lines.shape[0] // 2 - 8].astype(int)
    assert 16 <= (np.diff(row) == 1).sum() <= 34, "17 meridians and 16 diagonals, which meet some of them"
    opened.locator("[data-texture=roughness] img.zoom").click()
    shown = opened.locator("#enlarged img.layout")
    assert shown.is_visible() and shown.bounding_box() == opened.locator("#enlarged img").first.bounding_box()
    opened.keyboard.press("Escape")
    opened.uncheck("#layout")
    assert not layouts.first.is_visible()
