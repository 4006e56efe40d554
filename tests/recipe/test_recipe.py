"""Recipes: what is understood, what is refused and with which words."""

from dataclasses import replace
from inspect import signature
from pathlib import Path

import pytest
import yaml
from hypothesis import given, settings
from hypothesis import strategies as st

from navlearn.error_models.anarx import AnarxOptions
from navlearn.error_models.safeguard import rolling_origin_gate
from navlearn.errors import ConfigError, LogNotFoundError, NavlearnError
from navlearn.fusion.options import EkfOptions
from navlearn.learning.options import TrainingOptions
from navlearn.outages.schedule import OutageProtocol
from navlearn.recipe import AnarxSpec, Recipe, load_recipe, load_spec, recipe_for
from navlearn.recipe.sections import OutageSection
from navlearn.recipe.spec import BUILT_IN

LEAST = "name: small\nlog: {path: drive, format: csv}\n"


def write(folder: Path, text: str, name: str = "recipe.yaml") -> Path:
    path = folder / name
    path.write_text(text, encoding="utf-8")
    return path


def refusal(folder: Path, text: str) -> str:
    with pytest.raises(ConfigError) as caught:
        load_recipe(write(folder, text))
    return str(caught.value)


def test_defaults_are_filled_in(tmp_path: Path) -> None:
    recipe = load_recipe(write(tmp_path, LEAST))
    assert recipe.methods == ("dead_reckoning", "ekf_plain", "ekf")
    assert (recipe.outages.count, recipe.outages.duration_s) == (10, 60.0)
    assert recipe.mechanization.dims == 2
    assert recipe.calibration.gnss_latency == "estimate"


def test_log_path_is_relative_to_the_recipe(tmp_path: Path) -> None:
    (tmp_path / "deep").mkdir()
    path = write(tmp_path / "deep", "name: a\nlog: {descriptor: ../there/log.yaml}\n")
    assert load_recipe(path).log.descriptor == (tmp_path / "there" / "log.yaml").resolve()


def test_spec_is_read_relative_to_the_recipe(tmp_path: Path) -> None:
    write(tmp_path, "name: tiny\nhidden: 2\n", "tiny.yaml")
    (tmp_path / "deep").mkdir()
    text = LEAST + "models: [../tiny.yaml]\nmethods: [ekf, tiny]\n"
    recipe = load_recipe(write(tmp_path / "deep", text))
    assert recipe.model("tiny") == AnarxSpec(name="tiny", hidden=2)


def test_resolved_recipe_loads_as_the_same_recipe(tmp_path: Path) -> None:
    write(tmp_path, "name: tiny\ninputs: [speed]\nsafeguard: {output_limit: 3}\n", "tiny.yaml")
    text = LEAST + (
        "models: [tiny.yaml]\nmethods: [tiny, ekf]\nseed: 7\n"
        "outages: {placement: listed, times_s: [700, 900.5], duration_s: 30}\n"
        "training: {window_s: 600}\ncalibration: {odometer_latency: -0.35}\n"
    )
    recipe = load_recipe(write(tmp_path, text))
    elsewhere = tmp_path / "run"
    elsewhere.mkdir()
    again = write(elsewhere, yaml.safe_dump(recipe.resolved()), "resolved.yaml")
    assert load_recipe(again) == recipe
    assert recipe.outages.count == 2


def test_resolved_recipe_states_every_key_and_the_versions(tmp_path: Path) -> None:
    resolved = load_recipe(write(tmp_path, LEAST)).resolved()
    assert set(resolved) == {*Recipe.model_fields, "versions"}
    assert set(resolved["outages"]) == set(OutageSection.model_fields)
    assert set(resolved["versions"]) >= {"navlearn", "torch", "python"}


def test_outage_section_has_the_defaults_of_the_protocol() -> None:
    assert OutageSection().protocol() == OutageProtocol()


def test_outage_section_becomes_the_protocol_it_says() -> None:
    section = OutageSection(placement="listed", times_s=(5, 90), count=2, duration_s=9, seed=3)
    protocol = section.protocol()
    assert protocol.times == (5.0, 90.0)
    assert (protocol.duration, protocol.seed) == (9.0, 3)


def test_satellites_that_stay_reach_the_protocol(tmp_path: Path) -> None:
    named = "outages: {visible: listed, visible_satellites: [G07, E12], min_elevation_deg: 30}\n"
    protocol = load_recipe(write(tmp_path, LEAST + named)).outages.protocol()
    # As many stay as are listed, where nothing else is said.
    assert (protocol.satellites, protocol.visible_satellites) == (2, ("G07", "E12"))
    assert protocol.min_elevation == pytest.approx(0.5235987755982988)
    assert OutageSection().protocol().min_elevation == pytest.approx(OutageProtocol().min_elevation)
    one = named.replace("visible:", "satellites: 1, visible:")
    assert load_recipe(write(tmp_path, LEAST + one)).outages.protocol().satellites == 1
    for entry, words in (
        ("satellites: -1", "outages.satellites is -1"),
        ("visible: lowest", "outages.visible is 'lowest'"),
        ("visible_satellites: [G07]", "for visible 'listed', each once, and only for it"),
        ("visible: listed", "for visible 'listed', each once, and only for it"),
        ("visible: listed, visible_satellites: [G07, G07]", "each once"),
        ("visible: listed, visible_satellites: [seven]", "outages.visible_satellites[0]"),
        ("visible: listed, visible_satellites: [G07], satellites: 2", "lists 1"),
        ("min_tracked: 1.5", "outages.min_tracked is 1.5"),
        ("min_elevation_deg: 90", "outages.min_elevation_deg is 90"),
    ):
        assert words in refusal(tmp_path, f"{LEAST}outages: {{{entry}}}\n")


def test_filter_overrides_lie_over_the_defaults(tmp_path: Path) -> None:
    text = LEAST + (
        "filter: {model: bias_free, correlation_time: .inf, lever_arm: [0, 1, 2],\n"
        "  gyro_terms: [bias, scale], noise: {turn_noise: 1e-3}, initial: {gyro: {bias: 0.5}}}\n"
    )
    recipe = load_recipe(write(tmp_path, text))
    options, default = recipe.ekf_options(), EkfOptions()
    assert options.model == "bias_free"
    assert options.lever_arm == (0.0, 1.0, 2.0)
    assert options.noise == replace(default.noise, turn_noise=1e-3)
    assert options.initial.gyro == {**default.initial.gyro, "bias": 0.5}
    assert options.gate == default.gate
    again = write(tmp_path, yaml.safe_dump(recipe.resolved()), "resolved.yaml")
    assert load_recipe(again) == recipe
    assert load_recipe(again).ekf_options() == options


def test_spec_has_the_defaults_of_the_model_that_it_describes() -> None:
    spec = AnarxSpec(name="anarx")
    assert spec.anarx_options(outputs=2) == AnarxOptions(inputs=3, outputs=2, lags=1, hidden=3)
    assert spec.training_options() == TrainingOptions(objective="accumulated", ridge=1.0)
    gate = signature(rolling_origin_gate).parameters
    assert spec.safeguard.gate_margin == gate["margin"].default
    assert spec.safeguard.gate_fewest == gate["fewest"].default


def test_spec_reaches_the_options_of_model_and_training() -> None:
    content = {
        "lags": 3,
        "hidden": 2,
        "activation": "tanh",
        "linear_path": False,
        "safeguard": {"bounds": False, "output_limit": 2.0},
        "trainer": "adam",
        "loop": "open",
        "objective": "step",
        "max_iterations": 7,
        "patience": 3,
        "starts": 4,
        "ridge": 0.5,
        "learning_rate": 0.25,
        "seed": 9,
    }
    spec = AnarxSpec.model_validate({"name": "a", "inputs": ["speed"], **content})
    options, training = spec.anarx_options(outputs=1), spec.training_options()
    assert (options.inputs, options.lags, options.hidden) == (1, 3, 2)
    assert (options.activation, options.linear_path) == ("tanh", False)
    assert (options.safeguard, options.output_limit) == (False, 2.0)
    assert (training.trainer, training.loop, training.seed) == ("adam", "open", 9)
    assert (training.max_iterations, training.patience, training.starts) == (7, 3, 4)
    assert (training.ridge, training.learning_rate) == (0.5, 0.25)


@pytest.mark.parametrize(
    ("entry", "words"),
    [
        ("methds: [ekf]", ["recipe.yaml:3", "unknown key 'methds'", "did you mean 'methods'"]),
        ("outages: {cont: 3}", ["'cont' in outages", "did you mean 'count'"]),
        ("outages:\n  count: 3\n  sed: 3", ["recipe.yaml:5", "did you mean 'seed'"]),
        ("outages: {placement: sprad}", ["'spread', 'listed'", "did you mean 'spread'"]),
        ("outages: {count: 0}", ["outages.count is 0", "greater than or equal to 1"]),
        ("outages: {duration_s: .inf}", ["outages.duration_s is inf", "finite"]),
        ("outages: {duration_s: soon}", ["outages.duration_s is 'soon'", "number"]),
        ("outages: {placement: listed}", ["times_s", "listed"]),
        ("outages: {times_s: [3]}", ["times_s", "placement 'spread'"]),
        ("outages: {placement: listed, times_s: [3], count: 2}", ["count is 2", "lists 1"]),
        ("outages: {classes: [turn, turn]}", ["classes", "each once"]),
        ("seed: -1", ["seed is -1", "greater than or equal to 0"]),
        ("mechanization: {dims: 4}", ["mechanization.dims is 4", "2 or 3"]),
        ("training: {horizon_s: 0.5}", ["shorter than one step_s"]),
        ("training: {window_s: 10}", ["shorter than horizon_s"]),
        ("training: {regime: other}", ["training.regime is 'other'", "'online'"]),
        ("calibration: {gnss_latency: guess}", ["'estimate' or seconds", "'guess'"]),
        ("methods: [efk]", ["unknown method 'efk'", "did you mean 'ekf'"]),
        ("methods: [ekf, ekf]", ["'ekf' is listed twice"]),
        ("methods: []", ["methods", "at least 1"]),
        ("models: [nowhere.yaml]", ["recipe.yaml:3", "no model spec 'nowhere.yaml'"]),
        ("models: [{name: ekf}]", ["cannot be named 'ekf'"]),
        ("models: [{name: a}, {name: a}]", ["two models are named 'a'"]),
        ("models: [{name: a, safegard: {}}]", ["in models[0]", "did you mean 'safeguard'"]),
        ("models: [{name: a, safeguard: {gat: no}}]", ["models[0].safeguard", "'gate'"]),
        ("models: [{name: a, inputs: [sped]}]", ["models[0].inputs", "did you mean 'speed'"]),
        ("models: [{name: a, inputs: [speed, speed]}]", ["'speed' is listed twice"]),
        ("models: [{name: a, loop: open, objective: accumulated}]", ["models[0]", "loop: closed"]),
        ("models: [{name: a/b}]", ["'a/b' cannot be part of a file's name"]),
        ("name: twice", ["recipe.yaml:3", "'name' stands twice"]),
        ("filter: {modl: x}", ["filter", "unknown key 'modl'", "did you mean 'model'"]),
        ("filter: {noise: {gyro_walk: 1}}", ["'noise.gyro_walk'", "gyro_bias_walk"]),
        ("filter: {noise: {turn_noise: much}}", ["noise.turn_noise is 'much'", "number"]),
        ("filter: {noise: 3}", ["noise is 3", "mapping"]),
        ("filter: {model: bias}", ["model is 'bias'", "bias_scale"]),
        ("filter: {max_block: -1}", ["max_block", "more than 0 s"]),
        ("filter: 3", ["filter is 3", "dictionary"]),
        ('models: ["a\\0b"]', ["no model spec"]),
    ],
)
def test_refusal_names_place_and_remedy(tmp_path: Path, entry: str, words: list[str]) -> None:
    message = refusal(tmp_path, LEAST + entry + "\n")
    for word in words:
        assert word in message


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("", ["found nothing"]),
        ("- a\n- b\n", ["mapping", "found a list"]),
        ("name: [unclosed\n", ["not valid YAML", "line"]),
        ("name: a\n", ["'log' is missing"]),
        ("name: a\nlog: {}\n", ["one of 'descriptor', 'path' (with 'format') and 'simulated'"]),
        (
            "name: a\nlog: {simulated: {profile: jaradat2017, grade: tactical}}\n",
            ["grade is 'tactical'", "has its own sensors, length and rates; leave it out"],
        ),
        ("name: a\nlog: {descriptor: b.yaml, format: csv}\n", ["'format' belongs to 'path'"]),
        ("name: a\nlog: 3\n", ["recipe.yaml:2", "log is 3"]),
        ('name: a\nlog: {path: "a\\0b"}\n', ["recipe.yaml:2", "cannot be a path"]),
    ],
)
def test_refusal_of_whole_files(tmp_path: Path, text: str, words: list[str]) -> None:
    message = refusal(tmp_path, text)
    for word in words:
        assert word in message


def test_all_findings_are_listed_at_once(tmp_path: Path) -> None:
    message = refusal(tmp_path, LEAST + "sed: 1\noutages: {cont: 2}\n")
    assert "'sed'" in message
    assert "'cont'" in message


def test_missing_and_binary_files(tmp_path: Path) -> None:
    with pytest.raises(LogNotFoundError, match=r"absent\.yaml: there is no such recipe"):
        load_recipe(tmp_path / "absent.yaml")
    with pytest.raises(LogNotFoundError, match="no such model spec"):
        load_spec(tmp_path)
    (tmp_path / "binary.yaml").write_bytes(b"\xff\xfe\x00\x81")
    with pytest.raises(ConfigError, match="not text"):
        load_recipe(tmp_path / "binary.yaml")


def test_recipe_for_a_log_with_its_default_model() -> None:
    recipe = recipe_for("drives/my drive.mat", "navinst", outages="3x20", methods=["ekf", "anarx"])
    assert recipe.name == "my_drive"
    assert (recipe.outages.count, recipe.outages.duration_s) == (3, 20.0)
    assert recipe.model("anarx") == AnarxSpec(name="anarx")
    assert recipe.log.path is not None
    assert recipe.log.path.is_absolute()


def test_recipe_for_takes_yaml_for_a_descriptor() -> None:
    recipe = recipe_for("datasets/drive.yaml", methods=["ekf"])
    assert recipe.log.descriptor == Path("datasets/drive.yaml").resolve()
    assert recipe.models == ()


def test_layout_of_another_descriptor_is_found_from_anywhere(tmp_path: Path) -> None:
    text = "name: a\nlog: {path: drive, format: layouts/mine.yaml}\n"
    recipe = load_recipe(write(tmp_path, text))
    assert recipe.log.format == str(tmp_path.resolve() / "layouts" / "mine.yaml")
    made = recipe_for("drive", "layouts/mine.yaml", methods=["ekf"])
    assert made.log.format == str(Path("layouts/mine.yaml").resolve())


@pytest.mark.parametrize("text", ["10", "x60", "0x60", "10x0", "10x-5", "ten", "10x60x3", ""])
def test_outages_that_are_not_understood(text: str) -> None:
    with pytest.raises(ConfigError, match=r"10x60"):
        recipe_for("a", outages=text)


_scalars = st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=8)
_values = st.recursive(
    _scalars,
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.text(max_size=6), inner),
    max_leaves=8,
)


@settings(max_examples=150, deadline=None)
@given(content=st.dictionaries(st.sampled_from(list(Recipe.model_fields)), _values))
def test_whatever_is_written_loads_or_is_refused(
    tmp_path_factory: pytest.TempPathFactory, content: dict[str, object]
) -> None:
    path = write(tmp_path_factory.mktemp("fuzz"), yaml.safe_dump(content))
    try:
        assert isinstance(load_recipe(path), Recipe)
    except NavlearnError as problem:
        if str(path) not in str(problem):
            pytest.fail(f"the refusal does not name the file: {problem}")


@settings(max_examples=100, deadline=None)
@given(text=st.text(max_size=60))
def test_any_text_loads_or_is_refused(tmp_path_factory: pytest.TempPathFactory, text: str) -> None:
    path = tmp_path_factory.mktemp("fuzz") / "recipe.yaml"
    path.write_bytes(text.encode("utf-8", "surrogatepass"))
    with pytest.raises(NavlearnError):
        load_recipe(path)


@pytest.mark.parametrize("name", sorted(BUILT_IN))
def test_a_safeguard_stated_in_part_keeps_the_rest_of_its_kind(name: str) -> None:
    spec = BUILT_IN[name]
    kind, own = type(spec), type(spec).model_fields["safeguard"].default
    content = {**spec.model_dump(exclude={"safeguard"}), "safeguard": {"gate_fewest": 7}}
    made = kind.model_validate(content).safeguard
    assert made == own.model_copy(update={"gate_fewest": 7})
