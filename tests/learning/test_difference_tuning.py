"""Filters tuned by differences, judged on drives that they were not tuned on."""

import pytest
import torch

from navlearn.errors import ConfigError, FitError, LogError
from navlearn.fusion.options import EkfOptions
from navlearn.learning.difference_tuning import BELIEVED, tuned_by_differences
from navlearn.learning.integrated_errors import (
    integrated_errors,
    mean_squares,
    solution_errors,
)
from navlearn.learning.referenced_drive import ReferencedDrive, referenced_drive
from navlearn.logs.drive_log import DriveLog
from navlearn.logs.resample import riss_timeline
from navlearn.logs.synthetic import simulate_drive
from navlearn.recipe.filter_options import ekf_options

FLAT = {"mechanization": {"dimensions": 2}}


def log_of(seed: int, grade: str = "tactical", duration: float = 900.0) -> DriveLog:
    return simulate_drive(
        profile="mixed", grade=grade, duration=duration, seed=seed, imu_rate_hz=10.0
    ).log


def drive_of(log: DriveLog, dims: int = 2) -> ReferencedDrive:
    return referenced_drive(log, riss_timeline(log, rate_hz=10.0, dims=dims))


@pytest.fixture(scope="module")
def drives() -> tuple[ReferencedDrive, ReferencedDrive]:
    return drive_of(log_of(11)), drive_of(log_of(12))


def horizontal(drive: ReferencedDrive, options: EkfOptions) -> float:
    squares = mean_squares([integrated_errors(drive, options)])
    return (squares["east"] + squares["north"]) ** 0.5


def azimuth(drive: ReferencedDrive, options: EkfOptions) -> float:
    return mean_squares([integrated_errors(drive, options)])["azimuth"] ** 0.5


def test_tuned_on_one_drive_it_is_better_on_another(
    drives: tuple[ReferencedDrive, ReferencedDrive],
) -> None:
    before = ekf_options(FLAT)
    fit, judge = drives
    after = ekf_options({**FLAT, **tuned_by_differences([fit], before).filter})
    assert azimuth(judge, after) < 0.7 * azimuth(judge, before)
    assert horizontal(judge, after) < 0.95 * horizontal(judge, before)


def test_the_gyro_of_the_grade_is_found(drives: tuple[ReferencedDrive, ReferencedDrive]) -> None:
    noise = tuned_by_differences([*drives], ekf_options(FLAT)).filter["noise"]
    true = torch.deg2rad(torch.tensor(0.1)).item() / 60.0  # °/√h, class T
    assert noise["gyro_random_walk"] == pytest.approx(true, rel=0.2)


def test_white_fix_errors_trust_fixes_more(
    drives: tuple[ReferencedDrive, ReferencedDrive],
) -> None:
    before = ekf_options(FLAT)
    lasting = tuned_by_differences(drives, before)
    white = tuned_by_differences(drives, before, fix_errors="white")
    factor = lasting.figures["fixes_per_independent_fix"]
    assert isinstance(factor, dict)
    assert factor["position"] > 20.0
    ratio = (
        lasting.filter["noise"]["position_inflation"] / white.filter["noise"]["position_inflation"]
    )
    assert ratio == pytest.approx(factor["position"] ** 0.5)


def test_one_lucky_drive_does_not_make_a_scale_sure(
    drives: tuple[ReferencedDrive, ReferencedDrive],
) -> None:
    before = ekf_options(FLAT)
    one = [
        tuned_by_differences([drive], before).filter["initial"]["speed"]["scale"]
        for drive in drives
    ]
    both = tuned_by_differences(drives, before).filter["initial"]["speed"]["scale"]
    floor = (BELIEVED / (BELIEVED + 1)) ** 0.5 * before.initial.speed["scale"]
    assert min(one) >= floor
    assert both < max(one)


@pytest.mark.parametrize("model", ["bias_free", "shen2010", "shen2010_full"])
def test_every_model_can_be_tuned_and_run(
    model: str, drives: tuple[ReferencedDrive, ReferencedDrive]
) -> None:
    base = {**FLAT, "model": model}
    values = tuned_by_differences([drives[0]], ekf_options(base))
    after = ekf_options({**base, **values.filter})
    errors = integrated_errors(drives[1], after)
    assert bool(errors.east.isfinite().all())


def test_in_three_dimensions_pitch_and_height_are_tuned_too() -> None:
    drive = drive_of(log_of(13, "mems_m", 600.0), dims=3)
    values = tuned_by_differences([drive], EkfOptions())
    assert {"height_walk", "pitch_bias_walk"} <= set(values.filter["noise"])
    assert values.filter["initial"]["pitch_bias"] > 0.0
    assert "hill_walk" not in values.filter["noise"]
    ekf_options(values.filter)


def test_initial_deviations_are_those_of_the_settled_filter(
    drives: tuple[ReferencedDrive, ReferencedDrive],
) -> None:
    before = ekf_options(FLAT)
    initial = tuned_by_differences([drives[0]], before).filter["initial"]
    errors = integrated_errors(drives[0], before)
    squares = torch.stack((errors.east, errors.north)).square().mean()
    assert initial["position"] == pytest.approx(float(squares.sqrt()))
    assert initial["azimuth"] == pytest.approx(float(errors.azimuth.square().mean().sqrt()))


def test_errors_of_the_reference_itself_are_zero(
    drives: tuple[ReferencedDrive, ReferencedDrive],
) -> None:
    reference = drives[0].reference
    found = solution_errors(reference, reference)
    assert all(float(channel.abs().max()) < 1e-6 for channel in found)


def test_a_reference_of_positions_and_velocities_serves_by_its_course() -> None:
    log = log_of(12)
    assert log.reference is not None
    bare = log.with_tables({"reference": log.reference.drop(columns=["azimuth", "pitch", "roll"])})
    noise = tuned_by_differences([drive_of(bare)], ekf_options(FLAT)).filter["noise"]
    whole = tuned_by_differences([drive_of(log)], ekf_options(FLAT)).filter["noise"]
    assert noise["position_walk"] == pytest.approx(whole["position_walk"], rel=0.3)


def test_what_cannot_be_tuned_is_refused_in_words() -> None:
    log = log_of(12, duration=300.0)
    assert log.reference is not None
    with pytest.raises(FitError, match="no drive was given"):
        tuned_by_differences([], ekf_options(FLAT))
    with pytest.raises(ConfigError, match="choose among increments"):
        tuned_by_differences([drive_of(log)], ekf_options(FLAT), "guess")  # type: ignore[arg-type]
    positions = log.with_tables({"reference": log.reference[["t", "lat", "lon"]]})
    with pytest.raises(FitError, match="neither azimuth nor a velocity"):
        drive_of(positions)
    none = log.with_tables({"reference": log.reference.iloc[:0]})
    with pytest.raises(LogError, match="no reference"):
        drive_of(none)
