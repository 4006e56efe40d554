"""What a recipe's filter is tuned on, and how a gain is judged."""

import math
from dataclasses import replace

import numpy as np
import pytest
import torch

from navlearn.errors import ConfigError
from navlearn.experiment.drive import open_log
from navlearn.experiment.held_out_gain import held_out_gain
from navlearn.experiment.tuning_drives import laid_out, own_stretch, whole_stretches
from navlearn.experiment.tuning_recipes import other_draws
from navlearn.learning.held_out import HeldOutScores
from navlearn.recipe import Recipe
from navlearn.recipe.log_section import LogSource, SimulatedSection
from navlearn.recipe.sections import CalibrationSection, MechanizationSection, OutageSection


def _recipe(seed: int = 11) -> Recipe:
    made = SimulatedSection(grade="mems_m", duration_s=500.0, imu_rate_hz=5.0, seed=seed)
    return Recipe(
        name="little",
        log=LogSource(simulated=made),
        methods=("ekf",),
        mechanization=MechanizationSection(rate_hz=5.0),
        outages=OutageSection(count=1, duration_s=60.0, warm_up_s=330.0),
        calibration=CalibrationSection(odometer_latency=0.0, gnss_latency=0.0),
    )


def test_nothing_from_the_first_outage_on_is_ever_used(monkeypatch: pytest.MonkeyPatch) -> None:
    recipe = _recipe()
    found = own_stretch(recipe, 0.4)
    log = open_log(recipe)
    fixes = log.fixes.copy()
    fixes.loc[fixes["t"] >= 395.0, "lat"] += 1e-3
    imu = log.imu.copy()
    imu.loc[imu["t"] >= 395.0, "gyro_z"] += 0.1
    monkeypatch.setattr(
        "navlearn.experiment.tuning_drives.open_log",
        lambda _: replace(log, fixes=fixes, imu=imu),
    )
    spoilt = own_stretch(recipe, 0.4)
    assert found.end < 395.0
    for name, table in found.log.tables().items():
        assert table.equals(spoilt.log.tables()[name])
    assert found.tuning is not None
    assert float(found.tuning.fixes["t"].max()) < found.tuned_until < found.end
    assert found.judges


def test_other_draws_are_held_out_whole() -> None:
    recipe = _recipe()
    draws = other_draws(recipe, (12, 13, 14), (11,))
    stretches = whole_stretches(draws, 0.3)
    assert [stretch.judges for stretch in stretches] == [False, False, True]
    assert [stretch.tuning is None for stretch in stretches] == [False, False, True]
    assert stretches[0].made_from.log != stretches[1].made_from.log
    with pytest.raises(ConfigError, match="is scored"):
        other_draws(recipe, (12, 11), (11,))
    with pytest.raises(ConfigError, match="given twice"):
        whole_stretches(other_draws(recipe, (12, 12), (11,)), 0.3)


def test_a_single_other_drive_holds_out_its_end() -> None:
    (stretch,) = whole_stretches(other_draws(_recipe(), (12,), (11,)), 0.25)
    assert stretch.judges
    assert stretch.tuned_until == pytest.approx(0.75 * 500.0, abs=1.0)
    drive, start = laid_out(stretch.log, _recipe())
    assert drive.samples.dt.sum() == pytest.approx(500.0, abs=3.0)
    assert start == pytest.approx(stretch.begin, abs=1.0)


def _scores(gain: float, spread: float, count: int) -> HeldOutScores:
    g = np.random.default_rng(1)
    seconds = torch.full((count,), 60.0, dtype=torch.float64)
    before = torch.from_numpy(g.normal(-100.0, 30.0, count))
    more = torch.from_numpy(gain * 60.0 + spread * g.normal(size=count))
    return HeldOutScores(before=before, after=before + more, seconds=seconds)


def test_a_gain_counts_only_where_it_is_clear() -> None:
    clear = held_out_gain(_scores(0.5, 10.0, 30))
    assert clear.low < clear.gain < clear.high
    # as wide as Student's interval of a mean
    width = 2.0 * 2.045 * 10.0 / 60.0 / math.sqrt(30)
    assert clear.high - clear.low == pytest.approx(width, rel=0.35)
    assert clear.better
    worse = held_out_gain(_scores(-0.5, 10.0, 30))
    assert not worse.better
    assert worse.high < 0.0
    unclear = held_out_gain(_scores(0.01, 10.0, 30))
    assert not unclear.better
    alone = held_out_gain(_scores(0.5, 10.0, 1))
    assert not alone.better
    assert math.isnan(alone.low)


@pytest.mark.parametrize("count", [2, 3, 4, 6])
def test_an_interval_of_few_windows_holds_the_truth_as_often_as_it_says(count: int) -> None:
    g, held, draws = np.random.default_rng(count), 0, 300
    seconds = torch.full((count,), 60.0, dtype=torch.float64)
    before = torch.zeros_like(seconds)
    for _ in range(draws):
        after = torch.from_numpy(g.normal(30.0, 20.0, count))
        found = held_out_gain(HeldOutScores(before=before, after=after, seconds=seconds))
        held += found.low <= 0.5 <= found.high
    assert held / draws > 0.9
