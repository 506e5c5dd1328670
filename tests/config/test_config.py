"""The schema, its layers and its errors: every message names the dotted path."""

from pathlib import Path

import pytest
import yaml
from pydantic import ValidationError
from support.paths import ROOT

from mi_simplify.config import PRESETS, dump, json_schema, load_config, markdown, with_fixed
from mi_simplify.config.commands.face import load_face
from mi_simplify.config.commands.forest import load_forest
from mi_simplify.config.commands.transfer import load_transfer
from mi_simplify.config.layers import parse_override
from mi_simplify.config.problems import dotted_keys
from mi_simplify.errors import ConfigError

RELIC = {"asset": "sample:relic"}


def write(folder: Path, text: str) -> Path:
    path = folder / "job.yaml"
    path.write_text(text)
    return path


@pytest.mark.parametrize(
    ("override", "message"),
    [
        ("optimizer.stps=2", "^optimizer.stps: unknown key, did you mean 'steps'?"),
        ("optimizer.rates.vertex=2", "^optimizer.rates.vertex: unknown key, did you mean 'vertices'?"),
        ("optimiser.steps=2", "^optimiser: unknown key, did you mean 'optimizer'?"),
        ("steps=3", "^steps: unknown key, did you mean 'optimizer.steps'?"),
        ("zzz=3", "^zzz: unknown key; known here: asset, preset, "),
        ("optimizer.steps=many", "^optimizer.steps: should be a valid integer, got 'many'$"),
        ("optimizer.steps='200'", "^optimizer.steps: should be a valid integer, got '200'$"),
        ("optimizer.steps=true", "^optimizer.steps: should be a valid integer, got True$"),
        ("optimizer.steps=-1", "^optimizer.steps: should be greater than or equal to 0, got -1$"),
        ("optimizer.steps=", "^optimizer.steps: should be a valid integer, got None$"),
        ("optimizer.resolution=[64, wide]", "^optimizer.resolution.1: should be a valid integer, got 'wide'$"),
        ("optimizer.resolution=[]", "^optimizer.resolution: should hold at least one value$"),
        ("optimizer=3", "^optimizer: is a section, "),
        ("views.fov=.nan", "^views.fov: should be a finite number"),
        ("views.fov=180", "^views.fov: should be less than 180, got 180$"),
        ("reference.transport=full", "^reference.transport: should be 'direct', 'baked' or 'matched', got 'full'$"),
        ("latent.optimize=[normals]", "^latent.optimize.0: should be 'vertices', .*got 'normals'$"),
        ("latent.optimize=[normal, normal]", "^latent.optimize: should name nothing twice$"),
        ("initial.triangles=3", "^initial.triangles: should be greater than or equal to 4, got 3$"),
        ("initial.kind=mesh", "^initial: `kind: mesh` and `mesh: FILE` go together"),
        ("initial.keep_uv=true", "^initial: `keep_uv` is about the texture coordinates of `mesh: FILE`, which is not"),
        ("reference.environment=sky.exr", "^reference: `environment` lights the reference alone"),
        ("variant=scalar_rgb", "^variant: should be 'llvm_ad_rgb' or 'cuda_ad_rgb', got 'scalar_rgb'$"),
        ("preset=fst", "^preset: unknown preset 'fst', did you mean 'fast'?; one of fast, balanced, best$"),
        ("optimizer.steps", "an override reads key.subkey=value"),
        ("optimizer..steps=1", "an override reads key.subkey=value"),
        ("seed=[1", "^'seed=\\[1', line 1: not valid YAML: "),
    ],
)
def test_a_wrong_setting_is_one_line_with_its_dotted_path(override, message):
    with pytest.raises(ConfigError, match=message.replace("?", r"\?")) as caught:
        load_config(None, [RELIC, override])
    assert "\n" not in str(caught.value)


def test_several_problems_are_one_line_and_at_most_three_are_spelled_out():
    with pytest.raises(ConfigError) as caught:
        load_config(None, [RELIC, "seed=a", "variant=b", "views.fov=c", "optimizer.spp=d"])
    message = str(caught.value)
    assert message.count("got") == 3
    assert message.endswith("; and 1 more")


def test_an_asset_is_required():
    with pytest.raises(ConfigError, match="^asset: missing"):
        load_config()


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("optimizer:\n  steps: 1\n  steps: 2\n", "line 3: not valid YAML: 'steps' is set twice"),
        ("optimizer: [1\n", "line 2: not valid YAML"),
        ("- 1\n- 2\n", "expected sections with keys, got list"),
        ("a: !!python/object/apply:os.system ['true']\n", "not valid YAML"),
    ],
)
def test_a_broken_file_is_named_with_the_line(tmp_path, text, message):
    path = write(tmp_path, text)
    with pytest.raises(ConfigError, match=message) as caught:
        load_config(path)
    assert str(caught.value).startswith(str(path))


def test_files_that_cannot_be_read_are_named(tmp_path):
    with pytest.raises(ConfigError, match="none.yaml: no such configuration file"):
        load_config(tmp_path / "none.yaml")
    with pytest.raises(ConfigError, match="cannot be read: Is a directory"):
        load_config(tmp_path)
    (tmp_path / "model.glb").write_bytes(b"glTF\xff\xfe\x00")
    with pytest.raises(ConfigError, match="not a YAML text file"):
        load_config(tmp_path / "model.glb")


def test_precedence_is_defaults_preset_file_overrides(tmp_path, monkeypatch):
    monkeypatch.setitem(PRESETS, "fast", {"seed": 1, "optimizer": {"steps": 1, "batch": 1, "spp": 1}})
    path = write(tmp_path, "asset: sample:relic\npreset: fast\noptimizer: {batch: 2, spp: 2}\n")
    config = load_config(path, ["optimizer.spp=3"])
    assert (config.seed, config.optimizer.steps, config.optimizer.batch, config.optimizer.spp) == (1, 1, 2, 3)
    assert config.optimizer.decay == load_config(None, [RELIC]).optimizer.decay
    assert load_config(path, preset="balanced").optimizer.steps == load_config(None, [RELIC]).optimizer.steps


def test_a_start_from_a_sphere_brings_its_own_rates_below_preset_and_file(tmp_path, monkeypatch):
    monkeypatch.setitem(PRESETS, "fast", {"loss": {"coverage": 7.0}, "optimizer": {"steps": 1}})
    path = write(tmp_path, "asset: sample:relic\ninitial: {kind: sphere}\noptimizer: {rates: {normal: 0.5}}\n")
    usual, config = load_config(None, [RELIC]), load_config(path, preset="fast")
    assert config.initial.textures == "constant" and usual.initial.textures == "bake"
    assert config.optimizer.large_steps.lambda_ > 10 * usual.optimizer.large_steps.lambda_
    assert (config.loss.coverage, config.optimizer.rates.normal, config.optimizer.steps) == (7.0, 0.5, 1)
    assert load_config(write(tmp_path, dump(config))) == config
    assert load_config(path, ["initial.textures=bake"]).initial.textures == "bake"
    for kind in ("[sphere]", "cube"):
        with pytest.raises(ConfigError, match="^initial.kind"):
            load_config(None, [RELIC, f"initial.kind={kind}"])


def test_later_overrides_win_and_the_callers_dicts_stay_as_they_are():
    layer = {"asset": "sample:relic", "optimizer": {"steps": 1}}
    config = load_config(None, [layer, "optimizer.steps=2", "optimizer.steps=3"])
    assert config.optimizer.steps == 3
    assert layer == {"asset": "sample:relic", "optimizer": {"steps": 1}}


def test_relative_paths_follow_the_file_that_holds_them(tmp_path, monkeypatch):
    folder = tmp_path / "jobs"
    folder.mkdir()
    path = write(
        folder,
        "asset: ../model.obj\nreference: {transport: baked, environment: sky.exr}\n"
        "initial: {kind: mesh, mesh: /abs/low.ply}\n",
    )
    monkeypatch.chdir(tmp_path)
    config = load_config(path)
    assert Path(config.asset).resolve() == tmp_path / "model.obj"
    assert config.reference.environment == str(folder / "sky.exr")
    assert config.initial.mesh == "/abs/low.ply"
    assert load_config(path, ["asset=other.obj"]).asset == str(tmp_path / "other.obj")
    assert load_config(path, ["asset=sample:relic"]).asset == "sample:relic"


def test_values_follow_yaml_with_its_newer_numbers():
    assert parse_override("a.b=1e-3") == {"a": {"b": 0.001}}
    assert parse_override("a=-2.5E+2") == {"a": -250.0}
    assert parse_override("a=[1, x]") == {"a": [1, "x"]}
    assert parse_override("a=x=y") == {"a": "x=y"}
    assert parse_override("a=null") == {"a": None}


def test_a_single_value_stands_for_a_list_of_one():
    config = load_config(None, [RELIC, "optimizer.resolution=64", "export.formats=glb", "latent.optimize=normal"])
    assert config.optimizer.resolution == (64,)
    assert config.export.formats == ("glb",)
    assert config.latent.optimize == ("normal",)


def test_a_mesh_of_the_users_own_needs_no_budget(tmp_path):
    assert load_config(None, [RELIC]).initial.triangles == 3000
    assert load_config(None, [RELIC, "initial.triangles=null"]).initial.triangles == 3000
    low = [RELIC, "initial.kind=mesh", "initial.mesh=low.obj"]
    config = load_config(None, low)
    assert config.initial.triangles is None
    assert load_config(write(tmp_path, dump(config))) == config
    assert load_config(None, [*low, "initial.triangles=9"]).initial.triangles == 9


@pytest.mark.parametrize(
    ("names", "left"),
    [
        ([], ("vertices", "displacement", "vertex_sets", "skinning", "base_color", "roughness", "metallic", "normal")),
        (["kd", "orm"], ("vertices", "displacement", "vertex_sets", "skinning", "normal")),
        (["shape"], ("base_color", "roughness", "metallic", "normal")),
        (
            ["vertices", "normal", "gamma"],
            ("displacement", "vertex_sets", "skinning", "base_color", "roughness", "metallic"),
        ),
    ],
)
def test_what_is_skipped_is_not_fitted(names, left):
    config = load_config(None, [RELIC, "seed=4"])
    assert with_fixed(config, names).latent.optimize == left
    assert with_fixed(config, names).seed == 4


def test_wrong_names_of_quantities_are_one_line():
    config = load_config(None, [RELIC])
    with pytest.raises(ConfigError, match="'normals' is nothing that is fitted, did you mean 'normal'."):
        with_fixed(config, ["normals"])
    with pytest.raises(ConfigError, match="^nothing is left to fit"):
        with_fixed(config, ["shape", "kd", "orm", "normal"])


def test_a_config_is_frozen():
    config = load_config(None, [RELIC])
    with pytest.raises(ValidationError):
        config.optimizer.steps = 3


def test_the_dump_reads_back_as_the_same_config(tmp_path):
    config = load_config(None, [RELIC, "optimizer.resolution=[64, 128]", "views.fov=30", "seed=7"], preset="fast")
    text = dump(config)
    assert load_config(write(tmp_path, text)) == config
    assert "mitsuba 3.9" in text.splitlines()[0]
    assert yaml.safe_load(text)["seed"] == 7


@pytest.mark.parametrize("name", sorted(PRESETS))
def test_every_preset_is_valid(name):
    assert load_config(None, [RELIC], preset=name).preset == name


@pytest.mark.parametrize("path", sorted((ROOT / "scenes").glob("*.yaml")), ids=lambda p: p.name)
def test_every_example_loads(path):
    loaders = {"face": load_face, "forest": load_forest, "transfer": load_transfer}
    loaders.get(path.stem.split("_")[0], load_config)(path)


def test_the_documented_keys_are_those_of_the_schema():
    page = (ROOT / "docs" / "config.md").read_text()
    assert page == markdown(), "run `make docs`"
    for key in dotted_keys():
        assert f"| `{key}` |" in page


def test_every_key_says_what_it_means():
    def fields(schema):
        for part in [schema, *schema["$defs"].values()]:
            yield from part["properties"].items()

    assert [name for name, field in fields(json_schema()) if "$ref" not in field and not field.get("description")] == []


def test_mips_want_an_atlas_that_can_be_halved():
    with pytest.raises(ConfigError, match="needs an `initial.atlas_size` that is a power of two, it is 100"):
        load_config(None, [RELIC, "latent.mips=custom", "initial.atlas_size=100"])
    load_config(None, [RELIC, "initial.atlas_size=100"])
