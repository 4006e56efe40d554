"""Methods with ingredients: what they change of a filter, and what is refused."""

import dataclasses
from pathlib import Path

import pytest
import yaml

from navlearn.errors import ConfigError
from navlearn.experiment.baselines import filter_options
from navlearn.experiment.ins_filter_runs import ins_filter_options
from navlearn.experiment.methods import FIXED
from navlearn.filters.unscented import UnscentedOptions
from navlearn.fusion.gate_options import GateOptions
from navlearn.recipe import Recipe, load_recipe
from navlearn.recipe.fixed_methods import FIXED_METHODS
from navlearn.recipe.ingredients import INGREDIENTS, ingredients_of
from navlearn.recipe.overrides import laid_over
from navlearn.recipe.sweep import load_sweep

LEAST = "name: small\nlog: {path: drive, format: csv}\n"
TUNED = "{filter: {noise: {turn_noise: 0.007}, initial: {gyro: {bias: 0.25}}}}"
SECTIONS = f"integrity: {{reset_after: 4}}\ntuned: {TUNED}\nunscented: {{alpha: 0.5}}\n"
SWEEP = (
    "name: many\nsweep: {type: simulated, grades: [mems_l, tactical], drives: 1, first_seed: 11}\n"
)


def write(folder: Path, text: str, name: str = "recipe.yaml") -> Path:
    path = folder / name
    path.write_text(text, encoding="utf-8")
    return path


def refusal(folder: Path, text: str) -> str:
    with pytest.raises(ConfigError) as caught:
        load_recipe(write(folder, text))
    return str(caught.value)


@pytest.fixture
def recipe(tmp_path: Path) -> Recipe:
    filter_ = "filter: {noise: {speed_noise: 0.4}, gate: {probability: 0.99}}\n"
    methods = f"methods: [ekf, {', '.join(n for n in INGREDIENTS if n[:3] in ('ekf', 'ukf'))}]\n"
    return load_recipe(write(tmp_path, LEAST + filter_ + SECTIONS + methods))


@pytest.mark.parametrize("method", [name for name in INGREDIENTS if name[:3] in ("ekf", "ukf")])
def test_each_ingredient_changes_its_own_options_alone(recipe: Recipe, method: str) -> None:
    made, plain = ingredients_of(method), filter_options(recipe)
    options = filter_options(recipe, method)
    noise = dataclasses.replace(plain.noise, turn_noise=0.007)
    assert options.noise == (noise if made.tuned else plain.noise)
    assert options.noise.speed_noise == 0.4
    bias = {**plain.initial.gyro, "bias": 0.25}
    assert options.initial.gyro == (bias if made.tuned else plain.initial.gyro)
    asked = GateOptions(probability=0.99, reset_after=4 if made.integrity else 10)
    assert options.gate == asked
    assert options.unscented == (UnscentedOptions(alpha=0.5) if made.unscented else None)
    rest = {"noise": plain.noise, "initial": plain.initial, "gate": plain.gate, "unscented": None}
    assert dataclasses.replace(options, **rest) == plain  # type: ignore[arg-type]


def test_a_name_says_its_ingredients() -> None:
    for name, made in INGREDIENTS.items():
        assert made.unscented == ("ukf" in name)
        assert made.tuned == ("+tuned" in name)
        assert made.integrity == ("+integrity" in name)
        assert FIXED_METHODS[name].regime == ("tuned" if made.tuned else "none")
        assert name in FIXED
    assert not any(ingredients_of("ekf"))
    assert not any(ingredients_of("ekf+pci"))


def test_sigma_points_have_defaults_and_the_filters_own_below_them(tmp_path: Path) -> None:
    plain = load_recipe(write(tmp_path, LEAST + "methods: [ekf, ukf, ins_ukf]\n"))
    assert filter_options(plain, "ukf").unscented == UnscentedOptions()
    assert ins_filter_options(plain, "ins_ukf").unscented == UnscentedOptions()
    assert ins_filter_options(plain).unscented is None
    shared = "filter: {unscented: {alpha: 0.1, kappa: 1}}\nunscented: {alpha: 0.2}\n"
    both = load_recipe(write(tmp_path, LEAST + shared + "methods: [ekf, ukf]\n"))
    assert filter_options(both).unscented == UnscentedOptions(alpha=0.1, kappa=1.0)
    assert filter_options(both, "ukf").unscented == UnscentedOptions(alpha=0.2, kappa=1.0)


def test_a_full_imu_takes_what_was_tuned_for_it(tmp_path: Path) -> None:
    spec = "tuned: {sensors: imu, filter: {noise: {gyro_random_walk: 1.0e-4}}}\n"
    recipe = load_recipe(write(tmp_path, LEAST + spec + "methods: [ins_ekf, ins_ukf+tuned]\n"))
    options = ins_filter_options(recipe, "ins_ukf+tuned")
    assert options.noise.gyro_random_walk == 1e-4
    assert options.unscented == UnscentedOptions()
    assert ins_filter_options(recipe).noise.gyro_random_walk != 1e-4


def test_the_papers_own_filter_has_no_gate(recipe: Recipe) -> None:
    options = filter_options(recipe, "ekf_ghouneem2024")
    assert (options.model, options.gate) == ("shen2010", GateOptions(probability=1.0))
    assert filter_options(recipe, "ekf_shen2010").gate.probability == 0.99


def test_a_tuned_spec_is_read_relative_to_the_recipe(tmp_path: Path) -> None:
    write(tmp_path, "name: found\nfilter: {noise: {turn_noise: 0.02}}\n", "found.yaml")
    (tmp_path / "deep").mkdir()
    text = LEAST + "tuned: ../found.yaml\nmethods: [ekf, ekf+tuned]\n"
    recipe = load_recipe(write(tmp_path / "deep", text))
    assert filter_options(recipe, "ekf+tuned").noise.turn_noise == 0.02
    again = write(tmp_path, yaml.safe_dump(recipe.resolved()), "resolved.yaml")
    assert load_recipe(again) == recipe


def test_resolved_recipe_with_ingredients_is_the_same(recipe: Recipe, tmp_path: Path) -> None:
    again = write(tmp_path, yaml.safe_dump(recipe.resolved()), "resolved.yaml")
    assert load_recipe(again) == recipe
    assert filter_options(load_recipe(again), "ukf+tuned+integrity") == filter_options(
        recipe, "ukf+tuned+integrity"
    )


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("methods: [ekf, ekf+tuned]", "navlearn tune makes one"),
        ("methods: [ekf, ukf+integrity]", "state them under 'integrity'"),
        ("integrity: {reset_after: 4}", "integrity: no method takes it; list one of ekf+integrity"),
        (f"tuned: {TUNED}\nmethods: [ekf, ukf]", "tuned: no method takes it"),
        ("unscented: {alpha: 0.5}", "unscented: no method takes it; list one of ukf"),
        ("methods: [ukf]\nunscented: {alhpa: 0.5}", "did you mean 'alpha'"),
        ("methods: [ukf]\nunscented: {alpha: 0}", "expected in (0, 10]"),
        ("methods: [ukf]\nfilter: {unscented: {beta: wide}}", "unscented.beta is 'wide'"),
        ("methods: [ukf]\nfilter: {unscented: {betta: 1}}", "unknown key 'unscented.betta'"),
        ("methods: [ekf+integrity]\nintegrity: {reset_aftr: 4}", "did you mean 'reset_after'"),
        ("methods: [ekf+integrity]\nintegrity: {probability: 2}", "expected in (0, 1]"),
        ("methods: [ekf+tuned]\ntuned: nowhere.yaml", "there is no tuned spec 'nowhere.yaml'"),
        ("methods: [ekf+tuned]\ntuned: {filter: {niose: {}}}", "did you mean 'noise'"),
        (f"methods: [ins_ekf+tuned]\ntuned: {TUNED}", "needs a tuned spec of sensors 'imu'"),
        (
            "methods: [ekf+tuned]\ntuned: {sensors: imu, filter: {noise: {gyro_random_walk: 1}}}",
            "needs a tuned spec of sensors 'riss'",
        ),
    ],
)
def test_what_does_not_go_together_is_refused(tmp_path: Path, text: str, words: str) -> None:
    assert words in refusal(tmp_path, f"{LEAST}{text}\n")


def test_a_sweep_tunes_by_grade(tmp_path: Path) -> None:
    write(tmp_path, "name: poor\nfilter: {noise: {turn_noise: 0.05}}\n", "poor.yaml")
    own = "tuned_by_grade: {mems_l: poor.yaml}\n"
    methods = "methods: [ekf, ekf+tuned]\n"
    with pytest.raises(ConfigError, match="needs what was tuned"):
        load_sweep(write(tmp_path, SWEEP + methods + own))
    both = own + f"tuned: {TUNED}\n"
    sweep = load_sweep(write(tmp_path, SWEEP + methods + both))
    for grade, expected in {"mems_l": 0.05, "tactical": 0.007}.items():
        drive = sweep.for_drive("one", 60.0, grade)
        assert filter_options(drive, "ekf+tuned").noise.turn_noise == expected
    again = write(tmp_path, yaml.safe_dump(sweep.resolved()), "resolved.yaml")
    assert load_sweep(again) == sweep
    with pytest.raises(ConfigError, match="not among the grades"):
        load_sweep(write(tmp_path, SWEEP + methods + both.replace("mems_l", "mems_m")))


def test_a_recipe_can_be_tuned_before_it_is_tuned(tmp_path: Path) -> None:
    methods = "methods: [ekf, ekf+tuned, ukf+tuned+integrity]\n"
    limits = "integrity: {reset_after: 4}\nunscented: {alpha: 0.5}\n"
    path = write(tmp_path, LEAST + methods + limits + "tuned: not_yet.yaml\n")
    with pytest.raises(ConfigError, match="there is no tuned spec"):
        load_recipe(path)
    recipe = load_recipe(path, untuned=True)
    assert (recipe.methods, recipe.tuned) == (("ekf",), None)
    path = write(tmp_path, SWEEP + methods + limits + "tuned_by_grade: {mems_l: not_yet.yaml}\n")
    sweep = load_sweep(path, untuned=True)
    assert (sweep.methods, sweep.tuned_by_grade, sweep.integrity) == (("ekf",), {}, {})
    both = methods.replace("ekf,", "ekf, ukf+integrity,", 1)
    kept = load_recipe(write(tmp_path, LEAST + both + limits), untuned=True)
    assert kept.integrity == {"reset_after": 4}
    assert kept.unscented == {"alpha": 0.5}


def test_overrides_are_laid_over_group_by_group() -> None:
    below = {"a": 1, "noise": {"x": 1.0, "deep": {"p": 1, "q": 2}}, "none": None}
    above = {"noise": {"deep": {"q": 3}}, "none": {"z": 1}}
    expected = {"a": 1, "noise": {"x": 1.0, "deep": {"p": 1, "q": 3}}, "none": {"z": 1}}
    assert laid_over(below, above) == expected
    assert below["noise"] == {"x": 1.0, "deep": {"p": 1, "q": 2}}
