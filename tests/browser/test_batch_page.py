"""The page of a batch in headless Chromium: it sorts, it searches, it fits, nothing fails."""

from PIL import Image

from mi_simplify.jobs.batch.entries import Entry
from mi_simplify.jobs.batch.ledger import Outcome
from mi_simplify.jobs.batch.overview import write_overview


def test_rows_are_sorted_and_searched(browser, tmp_path):
    entries = [Entry(asset=f"{name}.obj", name=name) for name in ("oak", "rock", "lamp", "chair")]
    outcomes = {
        "oak": Outcome("oak", "f", 0, seconds=9, figures={"psnr": 31.0, "triangles": 900}),
        "rock": Outcome("rock", "f", 0, seconds=10, figures={"psnr": 40.0, "triangles": 10000}),
        "lamp": Outcome("lamp", "f", 2, "lamp.obj: no faces <script>alert(1)</script>", seconds=1),
    }
    (tmp_path / "rock").mkdir()
    Image.new("RGB", (384, 128)).save(tmp_path / "rock" / "thumbnail.jpg")
    page, problems = browser.new_page(viewport={"width": 1100, "height": 700}), []
    page.on("console", lambda message: problems.append(message.text))
    page.on("pageerror", lambda error: problems.append(str(error)))
    page.goto(write_overview(tmp_path, entries, outcomes).as_uri())

    def names() -> list[str]:
        shown = "rows => rows.filter(r => !r.hidden).map(r => r.cells[1].dataset.value)"
        return page.eval_on_selector_all("tbody tr", shown)

    assert names() == ["lamp", "oak", "rock", "chair"]
    page.click("th[data-key=triangles] button")
    assert names()[:2] == ["oak", "rock"]  # by number, not by letter
    page.click("th[data-key=triangles] button")
    assert names()[:2] == ["rock", "oak"]
    page.fill("#search", "no faces")
    assert names() == ["lamp"]
    assert page.evaluate("document.documentElement.scrollWidth <= innerWidth")
    assert page.eval_on_selector_all("img", "images => images.every(i => i.complete && i.naturalWidth)")
    assert problems == []
    page.close()


def test_of_many_the_first_are_shown_and_all_are_searched(browser, tmp_path):
    entries = [Entry(asset=f"m{k}.obj", name=f"m{k:05}") for k in range(1200)]
    outcomes = {e.name: Outcome(e.name, "f", 0, figures={"psnr": 20 + k / 100}) for k, e in enumerate(entries)}
    page = browser.new_page()
    page.goto(write_overview(tmp_path, entries, outcomes).as_uri())

    def names() -> list[str]:
        return page.eval_on_selector_all("tbody tr", "rows => rows.map(r => r.cells[1].dataset.value)")

    assert names() == [e.name for e in entries[:500]]
    page.click("th[data-key=psnr] button")
    page.click("th[data-key=psnr] button")
    assert names() == [e.name for e in entries[:-501:-1]]
    page.fill("#search", "m0010")
    assert names() == [f"m0010{k}" for k in range(9, -1, -1)] and page.is_hidden("#more")
    page.fill("#search", "M00")
    assert page.inner_text("#more") == "Show all 1000"
    page.click("#more")
    assert len(names()) == 1000 and page.is_hidden("#more")
    page.close()
