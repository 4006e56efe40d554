"""Fixes that are some time apart: which stay, what stays padding, what is free to be tuned."""

import pytest
import torch

from navlearn.errors import ConfigError, LogError
from navlearn.fusion.options import EkfOptions
from navlearn.learning.drive_likelihood import DriveLikelihood, TuningDrive
from navlearn.learning.noise_options import TuningOptions
from navlearn.learning.noise_parameters import FIX_ENTRIES, default_names
from navlearn.learning.noise_tuning import tune_noise
from navlearn.learning.spaced_fixes import spaced_fixes
from navlearn.logs.resample import riss_timeline
from navlearn.logs.synthetic import simulate_drive
from navlearn.mechanization.options import RissOptions
from navlearn.states import FixTiming

FLAT = EkfOptions(mechanization=RissOptions(dimensions=2))


@pytest.fixture(scope="module")
def drive() -> TuningDrive:
    made = simulate_drive(profile="town", grade="mems_m", duration=300.0, seed=13, imu_rate_hz=5.0)
    line = riss_timeline(made.log, rate_hz=5.0)
    return TuningDrive("town", line.samples, line.fixes, line.timing)


def _timing(index: list[int], delay: list[float]) -> FixTiming:
    return FixTiming(torch.tensor(index), torch.tensor(delay, dtype=torch.float64))


def test_times_of_fixes_decide_and_padding_stays() -> None:
    elapsed = 0.5 * torch.arange(1, 41, dtype=torch.float64)
    # valid at 1.0, 1.5, 2.9, 3.0, 5.0, none, 5.9, 7.0, none
    given = _timing([1, 2, 6, 6, 10, -1, 12, 13, -1], [0, 0, 0.6, 0.5, 0.5, 0, 0.6, 0, 0.3])
    found = spaced_fixes(given, elapsed, 2.0)
    assert found.index.tolist() == [1, -1, -1, 6, 10, -1, -1, 13, -1]
    assert found.delay[found.index >= 0].tolist() == [0.0, 0.5, 0.5, 0.0]
    assert found.delay[found.index < 0].abs().max() == 0.0
    assert spaced_fixes(given, elapsed, 0.0) is given
    none = spaced_fixes(_timing([-1, -1], [0.0, 0.0]), elapsed, 2.0)
    assert none.index.tolist() == [-1, -1]


def test_times_that_are_sums_do_not_lose_a_fix() -> None:
    elapsed = torch.cumsum(torch.full((1000,), 0.1, dtype=torch.float64), 0)
    index = torch.arange(9, 1000, 10)
    found = spaced_fixes(FixTiming(index, torch.zeros(100, dtype=torch.float64)), elapsed, 5.0)
    assert found.index[found.index >= 0].tolist() == index[::5].tolist()


def test_the_filter_meets_no_other_fix(drive: TuningDrive) -> None:
    own = DriveLikelihood(drive, FLAT, spacing=5.0)
    every = DriveLikelihood(drive, FLAT)
    there = own.line.occasion.fix.has_position[0] > 0.5
    valid = (own.time - own.line.occasion.delay[0])[there]
    assert float(valid.diff().min()) >= 5.0 - 1e-6
    assert float(valid.diff().max()) <= 6.0
    assert int((every.line.occasion.fix.has_position > 0.5).sum()) > 4.5 * int(there.sum())
    # the alignment is that of all fixes
    assert own.aligned == every.aligned
    assert torch.equal(own.start.covariance, every.start.covariance)


def test_what_is_told_of_single_fixes_is_not_taken_for_all(drive: TuningDrive) -> None:
    names = default_names(FLAT, 5.0)
    assert not set(names) & set(FIX_ENTRIES)
    assert set(default_names(FLAT)) == {*names, *(set(FIX_ENTRIES) & set(default_names(FLAT)))}
    quick = TuningOptions(spacing=5.0, iterations=1, rounds=1)
    assert set(tune_noise([drive], FLAT, quick, progress=False).values) == set(names)
    asked = TuningOptions(spacing=5.0, iterations=1, rounds=1, free=("position_inflation",))
    assert set(tune_noise([drive], FLAT, asked, progress=False).values) == {"position_inflation"}


def test_too_few_fixes_are_refused_with_their_spacing(drive: TuningDrive) -> None:
    with pytest.raises(LogError, match="fixes 30 s apart"):
        DriveLikelihood(drive, FLAT, spacing=30.0)
    for wrong in (-1.0, float("inf"), float("nan")):
        with pytest.raises(ConfigError, match="spacing"):
            TuningOptions(spacing=wrong)
