"""The page of a network in headless Chromium: it draws, the sky turns, frames change, nothing fails or is fetched."""

import numpy as np
import pytest
from markupsafe import Markup
from support.folding import folding

from mi_simplify.report.templates import render, script_hash, web_file
from mi_simplify.transfer.cast import unshadowed
from mi_simplify.transfer.dataset import bake
from mi_simplify.transfer.linear import fit_linear
from mi_simplify.transfer.page import write_page
from mi_simplify.transfer.player import Surface, player_data

from .test_report_page import page_of, picture


@pytest.fixture(scope="module")
def page_file(tmp_path_factory):
    """A page of a folding square whose "network" knows of no shadows."""
    data = bake(folding(), 16, n_directions=32)
    models = {"network": lambda p, n: unshadowed(n), "linear": fit_linear(data)}
    figures = {
        "models": {name: {"l1": 0.01, "psnr": 30.0} for name in (*models, "unshadowed")}, "network_bytes": 1000,
        "numbers": {"linear": 10, "coefficients": 20}, "history": [0.3, 0.2, 0.1],
    }  # fmt: skip
    return write_page(tmp_path_factory.mktemp("page") / "show.html", data, models, figures, 5, "folding <b>")


def test_the_page_says_everything_without_a_script(page_file):
    text = page_file.read_text()
    assert "folding &lt;b&gt;" in text
    assert text.count("<figure>") == 3 * 4 and text.count('<svg class="curve"') == 3


@pytest.fixture
def opened(browser, page_file):
    yield from page_of(browser, page_file, width=1366, height=768)


def shown(page) -> np.ndarray:
    """The three views as they are drawn now."""
    page.evaluate("new Promise((done) => requestAnimationFrame(() => requestAnimationFrame(done)))")
    return picture(page.locator("#player canvas"))


def put(page, name: str, value: int) -> None:
    """Move a slider."""
    move = f"(e) => {{ e.value = {value}; e.dispatchEvent(new Event('input')); }}"
    page.locator(f"#player [name={name}]").evaluate(move)


def test_the_player_shows_frames_under_a_turning_sky(opened):
    opened.wait_for_selector("#player[data-state=drawn]")
    first = shown(opened)
    rays, network, linear = np.array_split(first[:, : first.shape[1] // 3 * 3], 3, axis=1)
    assert (rays.sum(2) > 150).mean() > 0.03, "something is there"
    assert (rays.sum(2) > 150).mean() == pytest.approx((linear.sum(2) > 150).mean(), rel=0.1)
    assert network.sum() > 1.02 * rays.sum(), "no shadows, more light"
    put(opened, "turn", 120)
    assert np.abs(shown(opened) - first).mean() > 0.5
    put(opened, "turn", 360)
    assert np.abs(shown(opened) - first).mean() < 0.05, "a whole turn changes nothing"
    put(opened, "frame", 1)
    assert np.abs(shown(opened) - first).mean() > 0.05
    assert opened.evaluate("document.documentElement.scrollWidth <= innerWidth")


@pytest.fixture
def textured(browser, tmp_path):
    """A page with one square twice: grey at its vertices, and by a texture whose upper half is black."""
    positions, uvs = np.array([[[-1, 1, 0], [1, 1, 0], [1, -1, 0], [-1, -1, 0]]]), [[0, 0], [1, 0], [1, 1], [0, 1]]
    faces, grey = np.array([[0, 2, 1], [0, 3, 2]]), unshadowed(np.array([0.0, 0.0, 1.0]))
    half = np.repeat([0.0, 1.0], 4)[:, None, None] * np.broadcast_to(grey, (8, 8, 16))
    data = player_data([
        Surface(positions, faces, {"vertices": np.tile(grey, (1, 4, 1))}),
        Surface(positions, faces, {"texture": half[None]}, np.array(uvs)),
    ])  # fmt: skip
    script = web_file("webgl.js") + web_file("transfer.js")
    text = render(
        "transfer.html", title="square", version="", permitted=Markup(script_hash(script)), style="", data=data,
        rows=[{"sky": "", "cells": []}], table={"heads": [], "rows": []}, curves=[], script=Markup(script),
    )  # fmt: skip
    (tmp_path / "page.html").write_text(text)
    yield from page_of(browser, tmp_path / "page.html", width=800, height=600)


def test_the_player_looks_textures_up_the_right_way_up(textured):
    textured.wait_for_selector("#player[data-state=drawn]")
    vertices, texture = np.array_split(shown(textured).astype(float)[:, :-1], 2, axis=1)
    rows = [(0.35, 0.65), (0.35, 0.4), (0.6, 0.65)]
    middle, upper, lower = (slice(int(a * len(vertices)), int(b * len(vertices))) for a, b in rows)
    column = slice(int(0.48 * vertices.shape[1]), int(0.52 * vertices.shape[1]))
    assert vertices[middle, column].mean() > 60
    assert texture[upper, column].max() < 40
    np.testing.assert_allclose(texture[lower, column].mean((0, 1)), vertices[lower, column].mean((0, 1)), atol=4)
