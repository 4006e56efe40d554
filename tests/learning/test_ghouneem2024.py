"""The printed rule of [Ghouneem2024] against closed forms, and what comes of it."""

import math

import pytest
import torch

from navlearn.errors import ConfigError, FitError
from navlearn.fusion.noise_options import NoiseOptions
from navlearn.fusion.options import EkfOptions
from navlearn.learning.difference_tuning import tuned_by_differences
from navlearn.learning.ghouneem2024 import (
    PrintedDiagonals,
    printed_diagonals,
    printed_options,
    riss_errors,
)
from navlearn.learning.referenced_drive import ReferencedDrive, referenced_drive
from navlearn.logs.resample import riss_timeline
from navlearn.logs.synthetic import simulate_drive
from navlearn.mechanization.options import RissOptions
from navlearn.recipe.filter_options import ekf_options

FLAT = EkfOptions(mechanization=RissOptions(dimensions=2))


def simulated(seed: int, *, dims: int = 2) -> ReferencedDrive:
    log = simulate_drive(
        profile="mixed", grade="mems_m", duration=600.0, seed=seed, imu_rate_hz=10.0
    ).log
    return referenced_drive(log, riss_timeline(log, rate_hz=10.0, dims=dims))


@pytest.fixture(scope="module")
def drive() -> ReferencedDrive:
    return simulated(11)


def test_q_of_the_azimuth_is_the_average_of_the_run_on_difference(drive: ReferencedDrive) -> None:
    """A further gyro bias b turns RISS by −b t; reference minus RISS averages + b T / 2."""
    bias = 1e-4
    spoilt = drive._replace(samples=drive.samples._replace(yaw_rate=drive.samples.yaw_rate + bias))
    clean, biased = (printed_diagonals(one, FLAT).process for one in (drive, spoilt))
    change = biased["azimuth"] - clean["azimuth"]
    assert change == pytest.approx(0.5 * bias * float(drive.samples.dt.sum()), rel=0.01)


def test_a_bias_of_the_other_sign_gives_a_negative_variance(drive: ReferencedDrive) -> None:
    signs = set()
    for bias in (-0.01, 0.01):
        samples = drive.samples._replace(yaw_rate=drive.samples.yaw_rate + bias)
        found = printed_diagonals(drive._replace(samples=samples), FLAT)
        signs.add(math.copysign(1.0, found.process["azimuth"]))
        assert ("Q[azimuth]" in found.negative) == (found.process["azimuth"] < 0.0)
    assert signs == {-1.0, 1.0}


def test_it_grows_with_the_length_of_the_drive(drive: ReferencedDrive) -> None:
    samples = drive.samples._replace(yaw_rate=drive.samples.yaw_rate + 0.005)
    errors = riss_errors(drive._replace(samples=samples), FLAT)
    half = len(errors.azimuth) // 2
    assert abs(float(errors.azimuth.mean())) > 1.7 * abs(float(errors.azimuth[:half].mean()))


def test_real_drives_have_negative_entries_and_their_roots_are_not_numbers() -> None:
    for seed in (11, 12):
        found = printed_diagonals(simulated(seed), FLAT)
        assert found.negative, seed
        entries = torch.tensor([*found.process.values(), *found.initial.values()])
        assert bool(torch.sqrt(entries).isnan().any())


def test_as_printed_it_is_refused_with_the_names(drive: ReferencedDrive) -> None:
    negative = printed_diagonals(drive, FLAT).negative
    with pytest.raises(FitError, match="no variances") as found:
        tuned_by_differences([drive], FLAT, "ghouneem2024")
    assert all(name in str(found.value) for name in negative)
    assert "ghouneem2024_absolute" in str(found.value)


def test_no_filter_takes_what_is_not_a_number() -> None:
    with pytest.raises(ConfigError, match="gyro_random_walk: found nan"):
        EkfOptions(noise=NoiseOptions(gyro_random_walk=float(torch.sqrt(torch.tensor(-1.0)))))


def test_without_signs_there_is_a_filter(drive: ReferencedDrive) -> None:
    values = tuned_by_differences([drive], FLAT, "ghouneem2024_absolute")
    noise = ekf_options(values.filter).noise
    printed = printed_diagonals(drive, FLAT)
    assert noise.gyro_random_walk == pytest.approx(math.sqrt(abs(printed.process["azimuth"])))
    level = 0.5 * (abs(printed.process["east"]) + abs(printed.process["north"]))
    assert noise.position_walk == pytest.approx(math.sqrt(level))
    assert noise.position_inflation == 1.0
    assert values.figures["process"] == printed.process
    assert any("signs dropped" in note for note in values.notes)


def test_positive_entries_are_taken_as_printed() -> None:
    process = {"east": 4.0, "north": 5.0, "up": 9.0, "azimuth": 1e-6, "v_e": 0.25, "v_n": 0.25}
    initial = {"east": 1.0, "north": 1.0, "up": 4.0, "azimuth": 1e-4, "v_e": 0.1, "v_n": 0.2}
    diagonals = PrintedDiagonals(process, initial)
    assert diagonals.negative == ()
    shen = EkfOptions(model="shen2010")
    taken = printed_options(diagonals, shen, absolute=False)
    assert taken["noise"]["position_walk"] == pytest.approx(math.sqrt(4.5))
    assert taken["noise"]["height_walk"] == pytest.approx(3.0)
    assert taken["noise"]["velocity_walk"] == pytest.approx(0.5)
    assert taken["initial"]["azimuth"] == pytest.approx(0.01)
    flat = printed_options(diagonals, FLAT, absolute=False)
    assert flat["noise"]["hill_walk"] == pytest.approx(3.0)
    assert "velocity_walk" not in flat["noise"]
    assert "velocity" not in flat["initial"]
