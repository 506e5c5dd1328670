"""What a batch is asked for: folders, lists, manifests; and the one line of each mistake."""

import pytest
from support.toy import bumpy_sphere

from mi_simplify.errors import ConfigError
from mi_simplify.jobs.batch.entries import Entry, read_entries


@pytest.fixture
def models(tmp_path):
    folder = tmp_path / "models"
    (folder / "far").mkdir(parents=True)
    for name in ("a.ply", "b.obj", "b.ply", "far/c.glb", "notes.txt"):
        (folder / name).write_text(name)
    return folder


def test_a_folder_holds_its_models_each_under_a_name_of_its_own(models):
    entries = read_entries([str(models)], [], {"triangles": "500"})
    assert [e.name for e in entries] == ["a", "b-obj", "b-ply", "far-c"]
    assert {e.triangles for e in entries} == {"500"} and entries[3].asset.endswith("far/c.glb")
    assert [e.name for e in read_entries([str(models)], ["*.ply"], {})] == ["a", "b"]


def test_manifests_say_the_same_in_yaml_json_and_csv(models):
    (models / "list.yaml").write_text(
        "defaults: {triangles: 300, set: {optimizer.steps: 7}}\n"
        "assets:\n- a.ply\n- {asset: b.obj, name: second, triangles: '9000,3000', command: lod}\n"
    )
    (models / "list.json").write_text(
        '{"defaults": {"triangles": 300, "set": {"optimizer.steps": 7}}, "assets": ["a.ply", '
        '{"asset": "b.obj", "name": "second", "triangles": "9000,3000", "command": "lod"}]}'
    )
    (models / "list.csv").write_text(
        "asset,name,triangles,command,set\na.ply,,300,,optimizer.steps=7\n"
        'b.obj,second,"9000,3000",lod,optimizer.steps=7\n'
    )
    yaml, json, csv = (read_entries([str(models / f"list.{kind}")], [], {}) for kind in ("yaml", "json", "csv"))
    assert yaml == json == csv
    assert [(e.name, e.command, e.triangles) for e in yaml] == [
        ("a", "simplify", "300"),
        ("second", "lod", "9000,3000"),
    ]
    assert yaml[0].asset == str(models / "a.ply")  # relative to the manifest
    assert yaml[0].arguments("out") == [
        "simplify", str(models / "a.ply"), "-o", "out", "--quiet", "--triangles", "300", "--set", "optimizer.steps=7",
    ]  # fmt: skip


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("assets: []", "there is nothing to do"),
        ("asset: [a]", "expected 'assets', a list"),
        ("assets: [{name: x}]", "entry 1: expected a file name, or a section with 'asset'"),
        ("assets: [a.ply, {asset: b.ply, budget: 3}]", "entry 2: budget: unknown key"),
        ("assets: [{asset: a.ply, command: melt}]", "command: .*'simplify'.*got 'melt'"),
        ("assets: [a.ply, a.ply]", "two entries are called 'a-ply'"),
        ("assets: [{asset: a.ply, name: ../../etc}]", "leaves the output folder"),
        ("assets: {", "not valid YAML"),
    ],
)
def test_mistakes_in_a_manifest_are_one_line(models, text, message):
    (models / "list.yaml").write_text(text)
    with pytest.raises(ConfigError, match=message) as error:
        read_entries([str(models / "list.yaml")], [], {})
    assert "\n" not in str(error.value)


def test_sources_that_are_not_there(models):
    with pytest.raises(ConfigError, match="'nowhere' is neither a folder"):
        read_entries(["nowhere"], [], {})
    with pytest.raises(ConfigError, match=r"holds no model file of \*\.usd"):
        read_entries([str(models)], ["*.usd"], {})


def test_a_fingerprint_follows_content_and_settings(tmp_path):
    path = bumpy_sphere(tmp_path, 4)
    entry = Entry(asset=str(path), name="a")
    before = entry.fingerprint()
    assert before == Entry(asset=str(path), name="a").fingerprint()
    assert before != entry.model_copy(update={"triangles": "50"}).fingerprint()
    path.write_text(path.read_text() + "\n")
    assert entry.fingerprint() != before
