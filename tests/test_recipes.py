"""Every file of training/, models/ and datasets/ is opened, and every recipe runs one step."""

from pathlib import Path

import pytest
import yaml

from navlearn.errors import LogNotFoundError
from navlearn.experiment import run_recipe
from navlearn.experiment.sweep import run_sweep
from navlearn.logs.descriptor import load_descriptor
from navlearn.logs.reading import read_log
from navlearn.recipe import AnarxSpec, Recipe, load_recipe, load_spec
from navlearn.recipe.spec_base import SafeguardSpec
from navlearn.recipe.strict import parse
from navlearn.recipe.sweep import DegradedDrives, SweepRecipe, is_sweep, load_sweep

ROOT = Path(__file__).resolve().parents[1]
SWEEPS = sorted(path for path in (ROOT / "training").glob("*.yaml") if is_sweep(path))
RECIPES = sorted(set((ROOT / "training").glob("*.yaml")) - set(SWEEPS))
SPECS = sorted((ROOT / "models").glob("*.yaml"))
DESCRIPTORS = sorted((ROOT / "datasets").glob("*.yaml"))


def named(paths: list[Path]) -> pytest.MarkDecorator:
    return pytest.mark.parametrize("path", paths, ids=[path.stem for path in paths])


def cut_to_one_step(recipe: Recipe) -> Recipe:
    """Return the recipe with one outage and models that hardly train."""
    specs = [spec.model_copy(update={"max_iterations": 1, "starts": 1}) for spec in recipe.models]
    times = recipe.outages.times_s
    one = {"count": 1, "times_s": times[:1] if times else None}
    outages = recipe.outages.model_copy(update=one)
    return recipe.model_copy(update={"models": tuple(specs), "outages": outages})


def cut_to_one_drive(sweep: SweepRecipe) -> SweepRecipe:
    """Return the sweep with one outage on one drive, which is none of those that are scored."""
    content = sweep.resolved()
    del content["versions"]
    length = {} if isinstance(sweep.sweep, DegradedDrives) else {"duration_s": 1000.0}
    content["sweep"] |= {"grades": ["mems_l"], "drives": 1, "first_seed": 11, **length}
    content["sweep"]["durations_s"] = [60.0]
    by_grade = content["filter_by_grade"]
    content["filter_by_grade"] = {name: by_grade[name] for name in by_grade if name == "mems_l"}
    content["outages"]["count"] = 1
    for model in content["models"]:
        if model.get("type") == "anarx":
            model |= {"max_iterations": 1, "starts": 1}
    return parse(SweepRecipe, content, file=sweep.name)


def test_there_is_something_to_open() -> None:
    assert RECIPES
    assert SWEEPS
    assert SPECS
    assert DESCRIPTORS


@pytest.mark.parametrize("folder", ["training", "models", "datasets"])
def test_folders_hold_only_what_belongs_there(folder: str) -> None:
    allowed = {".yaml", ".md", ".py", ".pt", ".csv", ".gz", ".json"}
    for path in (ROOT / folder).rglob("*"):
        if path.is_file() and "__pycache__" not in path.parts:
            assert path.suffix in allowed, path
            assert path.name != "__init__.py", path
            if path.suffix == ".py":
                assert len(path.read_text(encoding="utf-8").splitlines()) <= 60, path


@named(RECIPES)
def test_recipe_parses_and_names_what_exists(path: Path) -> None:
    recipe = load_recipe(path)
    assert recipe.name == path.stem
    assert recipe.question.endswith("?")
    if recipe.log.descriptor is not None:
        assert recipe.log.descriptor.is_file()


@named(SWEEPS)
def test_sweep_parses_and_names_what_exists(path: Path) -> None:
    sweep = load_sweep(path)
    assert sweep.name == path.stem
    assert sweep.question.endswith("?")
    if isinstance(sweep.sweep, DegradedDrives):
        assert sweep.sweep.log.descriptor is not None
        assert sweep.sweep.log.descriptor.is_file()


@named(SPECS)
def test_spec_parses_and_has_a_card(path: Path) -> None:
    spec = load_spec(path)
    assert spec.name == path.stem
    assert spec.question.endswith("?")
    assert path.with_suffix(".md").is_file()


def test_shipped_anarx_is_the_one_that_needs_no_file() -> None:
    shipped = load_spec(ROOT / "models" / "anarx.yaml")
    assert shipped.model_copy(update={"question": ""}) == AnarxSpec(name="anarx")


def test_shipped_anarx_writes_out_every_key() -> None:
    written = yaml.safe_load((ROOT / "models" / "anarx.yaml").read_text(encoding="utf-8"))
    assert set(written) == set(AnarxSpec.model_fields) - {"notes"}
    assert set(written["safeguard"]) == set(SafeguardSpec.model_fields)


@named(DESCRIPTORS)
def test_descriptor_parses(path: Path) -> None:
    descriptor, _ = load_descriptor(path)
    assert descriptor.name == path.stem


# ekf_plain is meant to be wrong about its gyro, and the filter says so.
@pytest.mark.filterwarnings("ignore:filter. .*NIS:UserWarning")
@named(RECIPES)
def test_recipe_runs_one_step(path: Path, tmp_path: Path) -> None:
    recipe = cut_to_one_step(load_recipe(path))
    assert recipe.log.descriptor is not None
    try:
        read_log(recipe.log.descriptor)
    except LogNotFoundError as problem:
        pytest.skip(f"the log is not here: {problem}")
    result = run_recipe(recipe, tmp_path / "run", progress=False)
    assert list(result.table["method"]) == list(recipe.methods)
    assert (result.table["max_horizontal_error_m"] > 0.0).all()
    assert load_recipe(result.folder / "recipe.yaml") == recipe


@named(SWEEPS)
def test_sweep_runs_one_drive(path: Path, tmp_path: Path) -> None:
    sweep = cut_to_one_drive(load_sweep(path))
    if isinstance(sweep.sweep, DegradedDrives):
        assert sweep.sweep.log.descriptor is not None
        try:
            read_log(sweep.sweep.log.descriptor)
        except LogNotFoundError as problem:
            pytest.skip(f"the log is not here: {problem}")
    result = run_sweep(sweep, tmp_path / "run", progress=False)
    assert result.failures == ()
    assert list(result.table["method"]) == list(sweep.methods)
    assert (result.table["max_horizontal_error_m"] > 0.0).all()
    assert (result.table["failure"] == "").all()
    assert load_sweep(result.folder / "recipe.yaml") == sweep
