"""What stands in several files of the project is the same in all of them."""

import importlib.util
import re
import tomllib
import xml.etree.ElementTree as ElementTree
from pathlib import Path

import pytest
import yaml

import mi_simplify

ROOT = Path(__file__).parents[1]


def text(name: str) -> str:
    return (ROOT / name).read_text(encoding="utf-8")


@pytest.fixture(scope="module")
def citation() -> dict:
    return yaml.safe_load(text("CITATION.cff"))


def test_one_version_everywhere(citation):
    version = mi_simplify.__version__
    assert citation["version"] == version
    assert re.search(r"version = \{(.*)\}", text("CITATION.bib"))[1] == version
    released = re.findall(r"^## \[(\d.*?)\] - (\d{4}-\d\d-\d\d)$", text("CHANGELOG.md"), re.MULTILINE)
    assert released[0] == (version, str(citation["date-released"]))
    assert [date for _, date in released] == sorted((date for _, date in released), reverse=True)


def test_both_citations_name_the_same_works(citation):
    entries = text("CITATION.bib").split("\n@")[1:]  # after that of the software
    assert len(entries) == len(citation["references"]) == 3
    for entry, reference in zip(entries, citation["references"], strict=True):
        assert re.search(r"doi\s*= \{(.*)\}", entry)[1] == reference["doi"]
        assert re.search(r"year\s*= \{(.*)\}", entry)[1] == str(reference["year"])
        authors = re.split(r"\s+and\s+", re.search(r"author\s*= \{(.*?)\}", entry, re.DOTALL)[1])
        assert authors == [f"{a['family-names']}, {a['given-names']}" for a in reference["authors"]]


def test_the_source_distribution_has_every_file_of_the_top_level():
    settings = tomllib.loads(text("pyproject.toml"))["tool"]["hatch"]["build"]["targets"]["sdist"]["include"]
    top = {path.name for path in ROOT.glob("*.*") if path.suffix in (".md", ".yml", ".cff", ".bib")}
    assert all(any(Path(name).match(pattern) for pattern in settings) for name in top)
    for name in settings:
        assert list(ROOT.glob(name)), f"{name} is not there"


@pytest.mark.parametrize("path", sorted((ROOT / ".github").rglob("*.yml")), ids=lambda path: path.name)
def test_issue_forms(path):
    form = yaml.safe_load(path.read_text(encoding="utf-8"))
    if path.name == "config.yml":
        assert set(form) == {"blank_issues_enabled"}
        return
    assert form["name"] and form["description"] and form["body"]
    ids = [field["id"] for field in form["body"]]
    assert len(set(ids)) == len(ids)
    assert all(field["type"] == "textarea" and field["attributes"]["label"] for field in form["body"])


@pytest.fixture(scope="module")
def drawing():
    spec = importlib.util.spec_from_file_location("draw_architecture", ROOT / "docs" / "draw_architecture.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def test_the_architecture_shows_every_room_and_every_arrow_runs_down(drawing):
    package = ROOT / "mi_simplify"
    root = ElementTree.fromstring(drawing.svg(package))
    tag = "{http://www.w3.org/2000/svg}"
    top = {group.find(f"{tag}text").text: float(group.find(f"{tag}rect").get("y")) for group in root.iter(f"{tag}g")}
    rooms = {path.stem for path in package.iterdir() if path.suffix == ".py" or (path / "__init__.py").is_file()}
    assert top.keys() == {name for name in rooms if not name.startswith("__")}
    arrows = [path.find(f"{tag}title").text.split(" imports ") for path in root.iter(f"{tag}path") if len(path)]
    assert len(arrows) > 20 and all(top[a] < top[b] for a, b in arrows)
    assert ["cli", "jobs"] in arrows and ["cli", "errors"] not in arrows, "what follows from others is left out"


def test_rooms_in_a_circle_have_no_floor(drawing):
    assert drawing.reduced({"a": {"b", "c"}, "b": {"c"}, "c": set()}) == {"a": {"b"}, "b": {"c"}, "c": set()}
    with pytest.raises(SystemExit, match="import each other.*: a, b"):
        drawing.sorted_rooms({"a": {"b"}, "b": {"a"}, "c": set()})
