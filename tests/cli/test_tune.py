"""``navlearn tune``: what it writes, what it says, what it refuses."""

from pathlib import Path

import pytest
from typer.testing import CliRunner

from navlearn.cli import app
from navlearn.recipe.tuned_spec import read_tuned

RECIPE = """
name: little
log: {simulated: {profile: town, grade: mems_m, duration_s: 500, imu_rate_hz: 5, seed: 11}}
methods: [ekf]
mechanization: {dims: 2, rate_hz: 5}
filter: {noise: {speed_noise: 0.08}}
outages: {warm_up_s: 330, count: 1, duration_s: 60}
calibration: {odometer_latency: 0.0, gnss_latency: 0.0}
"""
SWEEP = """
name: swept
sweep: {type: simulated, profile: town, grades: [mems_m, mems_l], drives: 2, first_seed: 15}
methods: [ekf]
"""
QUICK = ("--quiet", "--free", "position_inflation,speed_noise", "--iterations", 3)


def invoke(*arguments: object, code: int = 0) -> str:
    result = CliRunner().invoke(app, [str(argument) for argument in arguments])
    if result.exit_code != code:
        raise AssertionError(f"exit {result.exit_code}: {result.output}") from result.exception
    return result.output


@pytest.fixture
def recipe(tmp_path: Path) -> Path:
    path = tmp_path / "little.yaml"
    path.write_text(RECIPE)
    return path


def test_a_recipe_is_tuned_on_what_lies_before_its_first_outage(recipe: Path) -> None:
    out = recipe.with_name("tuned.yaml")
    shown = invoke("tune", recipe, "--out", out, "--holdout", 0.4, *QUICK)
    spec = read_tuned(out)
    assert spec.method == "gradient"
    assert set(spec.filter["noise"]) == {"position_inflation", "speed_noise"}
    (made,) = spec.made_from
    assert made.until_s is not None
    # 40 % of at least 330 s are held out, and the outage begins after them
    assert 150.0 < made.until_s < 0.65 * 440.0
    assert spec.figures["held_out_windows"] >= 2
    assert spec.figures["recommended"] in (0, 1)
    outages = spec.figures["held_out_outages"]
    assert isinstance(outages, dict)
    assert outages["duration_s"] == 60.0
    assert outages["count"] == 1
    verdict = next(note for note in spec.notes if "recommended" in note)
    assert verdict.startswith("recommended") == bool(spec.figures["recommended"])
    assert "nats/s" in verdict
    assert "held-out outages of 60 s" in verdict
    assert verdict in shown
    for said in ("position_inflation", "fix, east and north", "95 % interval", "held-out", "Took"):
        assert said in shown
    assert not list(recipe.parent.glob("*.unfinished"))

    before = out.read_text()
    assert "exists" in invoke("tune", recipe, "--out", out, *QUICK, code=2)
    assert out.read_text() == before


def test_what_is_not_recommended_says_so(recipe: Path) -> None:
    out = recipe.with_name("none.yaml")
    shown = invoke("tune", recipe, "--out", out, "--holdout", 0, *QUICK)
    assert "nothing was held out, so nothing was judged" in shown
    assert "recommended" not in read_tuned(out).figures


def test_what_cannot_be_done_is_said_in_one_line(recipe: Path, tmp_path: Path) -> None:
    out, sweep = tmp_path / "t.yaml", tmp_path / "sweep.yaml"
    sweep.write_text(SWEEP)
    imu = tmp_path / "imu.yaml"
    imu.write_text(RECIPE.replace("{dims: 2, rate_hz: 5}", "{sensors: imu, rate_hz: 5}"))
    for said, arguments in (
        ("choose among gradient", (recipe, "--method", "guessing")),
        ("give a share", (recipe, "--holdout", 1.0)),
        ("give seconds", (recipe, "--spacing", -1)),
        ("is scored", (recipe, "--seeds", "12,11")),
        ("whole numbers", (recipe, "--seeds", "twelve")),
        ("give one of them", (recipe, "--seeds", "12", "--log", tmp_path)),
        ("tuned is the filter of one gyro", (imu,)),
        ("for sweeps only", (recipe, "--grade", "mems_m")),
        ("every drive of a sweep is scored", (sweep, "--grade", "mems_m")),
        ("choose one of mems_m, mems_l", (sweep, "--grade", "mems_x", "--seeds", 11)),
        ("is scored", (sweep, "--grade", "mems_m", "--seeds", 16)),
        ("gradient only", (recipe, "--method", "allan", "--free", "turn_noise")),
        ("one standstill of one drive", (recipe, "--method", "allan", "--seeds", "12,13,14")),
        ("lie before its first outage", (recipe, "--holdout", 0.1)),
        ("nothing that this filter uses", (recipe, "--holdout", 0.4, "--free", "velocity_walk")),
    ):
        shown = invoke("tune", *arguments, "--out", out, code=2)
        assert said in shown.replace("\n", " "), shown
    assert not out.exists()


def test_a_log_without_fixes_is_refused(recipe: Path, tmp_path: Path) -> None:
    drive = tmp_path / "drive"
    invoke("simulate", "--profile", "town", "--duration", 300, "--seed", 12, "--out", drive)
    fixes = next(drive.glob("fixes.csv*"))
    import pandas as pd

    pd.read_csv(fixes).iloc[:0].to_csv(fixes, index=False)
    shown = invoke("tune", recipe, "--log", drive, "--out", tmp_path / "t.yaml", code=2)
    assert "fix" in shown


@pytest.mark.parametrize("method", ["differences", "ghouneem2024"])
def test_rules_that_need_a_reference_go_the_same_way(recipe: Path, method: str) -> None:
    out = recipe.with_name(f"{method}.yaml")
    shown = invoke("tune", recipe, "--out", out, "--method", method, "--holdout", 0.4)
    spec = read_tuned(out)
    assert spec.method == method
    assert spec.filter["noise"]
    assert "held-out log-likelihood" in shown
    assert "held-out outages of 60 s" in shown
    assert "noise.position_walk" in shown or "noise.gyro_random_walk" in shown


def test_fixes_some_time_apart_tell_the_noise_of_motion_alone(recipe: Path) -> None:
    out = recipe.with_name("spaced.yaml")
    shown = invoke(
        "tune", recipe, "--out", out, "--spacing", 5, "--holdout", 0.4, "--iterations", 1, "--quiet"
    )
    spec = read_tuned(out)
    assert "gyro_random_walk" in spec.filter["noise"]
    assert not {"position_inflation", "velocity_floor"} & set(spec.filter["noise"])
    assert "fixes 5 s apart" in shown
    like = spec.figures["held_out_nats_per_s"]
    assert isinstance(like, dict)
    assert like["spacing_s"] == 5.0


def test_any_file_may_be_named_but_a_folder(recipe: Path, tmp_path: Path) -> None:
    out = tmp_path / "my tuned (2).yaml"
    invoke("tune", recipe, "--out", out, "--method", "differences", "--holdout", 0)
    assert read_tuned(out).name == "my_tuned__2_"
    folder = tmp_path / "folder"
    folder.mkdir()
    shown = invoke("tune", tmp_path / "none.yaml", "--out", folder, "--force", code=2)
    assert "is a folder" in shown.replace("\n", " ")
