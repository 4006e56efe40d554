"""Every file of training/, models/ and datasets/ is opened, and every recipe runs one step."""

from pathlib import Path
from typing import Any

import pytest
import yaml

from navlearn.errors import LogNotFoundError
from navlearn.experiment import run_recipe
from navlearn.experiment.sweep import run_sweep
from navlearn.logs.descriptor import load_descriptor
from navlearn.logs.reading import read_log
from navlearn.recipe import AnarxSpec, Recipe, load_recipe, load_spec
from navlearn.recipe.log_section import SCENARIO, LogSource
from navlearn.recipe.spec_base import SafeguardSpec
from navlearn.recipe.strict import parse
from navlearn.recipe.sweep import SweepRecipe, is_sweep, load_sweep
from navlearn.recipe.swept_drives import DegradedDrives, RecordedDrives, SimulatedDrives
from navlearn.recipe.tuned_spec import read_tuned

ROOT = Path(__file__).resolve().parents[1]
SWEEPS = sorted(path for path in (ROOT / "training").glob("*.yaml") if is_sweep(path))
RECIPES = sorted(set((ROOT / "training").glob("*.yaml")) - set(SWEEPS))
SPECS = sorted((ROOT / "models").glob("*.yaml"))
TUNED = sorted((ROOT / "training" / "tuned").glob("*.yaml"))
DESCRIPTORS = sorted((ROOT / "datasets").glob("*.yaml"))


def named(paths: list[Path]) -> pytest.MarkDecorator:
    return pytest.mark.parametrize("path", paths, ids=[path.stem for path in paths])


def cut_to_one_step(recipe: Recipe) -> Recipe:
    """Return the recipe with one outage, models that hardly train, and little of the drive."""
    content = recipe.resolved()
    del content["versions"]
    _hardly_training(content["models"])
    times = content["outages"]["times_s"]
    content["outages"] |= {"count": 1, "times_s": times[:1] if times else None}
    simulated = recipe.log.simulated
    if simulated is not None:
        content["log"]["simulated"]["seed"] = 11
    if simulated is not None and simulated.profile != SCENARIO:
        content["log"]["simulated"] |= {"duration_s": 500.0, "imu_rate_hz": 20.0}
    elif recipe.mechanization.sensors == "imu":
        content["mechanization"]["imu_rate_hz"] = 20.0
        if simulated is None:
            content["log"]["between_s"] = content["log"]["between_s"] or [0.0, 900.0]
    return parse(Recipe, content, file=recipe.name)


def cut_to_one_drive(sweep: SweepRecipe) -> SweepRecipe:
    """Return the sweep with one outage on one drive, which is none of the simulated scored ones."""
    content = sweep.resolved()
    del content["versions"]
    drives = content["sweep"]
    if isinstance(sweep.sweep, RecordedDrives):
        logs = drives["logs"][1:2] or drives["logs"]
        drives |= {"logs": logs, "durations_s": drives["durations_s"][:1]}
    else:
        # seeds that nothing was tuned on
        drives |= {"drives": 1, "first_seed": 13, "durations_s": drives["durations_s"][:1]}
    if isinstance(sweep.sweep, SimulatedDrives | DegradedDrives):
        drives |= {"grades": ["mems_l"], "durations_s": [60.0]}
    if isinstance(sweep.sweep, SimulatedDrives):
        drives |= {"duration_s": 1000.0}
    if "satellites" in drives:
        drives["satellites"] = drives["satellites"][:1]
    for name in ("filter_by_grade", "ins_filter_by_grade", "tuned_by_grade"):
        content[name] = {key: one for key, one in content[name].items() if key == "mems_l"}
    content["outages"]["count"] = 1
    _hardly_training(content["models"])
    return parse(SweepRecipe, content, file=sweep.name)


def _hardly_training(models: list[dict[str, Any]]) -> None:
    for model in models:
        if model.get("type") in ("anarx", "ins_anarx"):
            model |= {"max_iterations": 1, "starts": 1}


def log_of(source: LogSource) -> None:
    """Skip the test where a log is not here."""
    if source.descriptor is not None:
        try:
            read_log(source.descriptor)
        except LogNotFoundError as problem:
            pytest.skip(f"the log is not here: {problem}")


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
    logs: tuple[LogSource, ...] = (
        (sweep.sweep.log,) if isinstance(sweep.sweep, DegradedDrives) else ()
    )
    logs = sweep.sweep.logs if isinstance(sweep.sweep, RecordedDrives) else logs
    for log in logs:
        assert log.descriptor is not None
        assert log.descriptor.is_file()


@named(TUNED)
def test_tuned_spec_parses_and_says_what_it_was_made_from(path: Path) -> None:
    spec = read_tuned(path)
    assert spec.name == path.stem
    assert spec.made_from
    text = "".join(one.read_text(encoding="utf-8") for one in (*RECIPES, *SWEEPS))
    assert f"--out training/tuned/{path.name}" in text


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


# Filters without a gyro bias or in open loop are meant to be wrong, and say so.
@pytest.mark.filterwarnings("ignore:filter. :UserWarning")
@named(RECIPES)
def test_recipe_runs_one_step(path: Path, tmp_path: Path) -> None:
    recipe = cut_to_one_step(load_recipe(path))
    log_of(recipe.log)
    result = run_recipe(recipe, tmp_path / "run", progress=False)
    assert list(result.table["method"]) == list(recipe.methods)
    assert (result.table["max_horizontal_error_m"] > 0.0).all()
    assert load_recipe(result.folder / "recipe.yaml") == recipe


@pytest.mark.filterwarnings("ignore:filter. :UserWarning")
@named(SWEEPS)
def test_sweep_runs_one_drive(path: Path, tmp_path: Path) -> None:
    sweep = cut_to_one_drive(load_sweep(path))
    if isinstance(sweep.sweep, DegradedDrives):
        log_of(sweep.sweep.log)
    if isinstance(sweep.sweep, RecordedDrives):
        log_of(sweep.sweep.logs[0])
    result = run_sweep(sweep, tmp_path / "run", progress=False)
    assert result.failures == ()
    assert list(result.table["method"]) == list(sweep.methods)
    assert (result.table["max_horizontal_error_m"] > 0.0).all()
    assert (result.table["failure"] == "").all()
    assert load_sweep(result.folder / "recipe.yaml") == sweep
