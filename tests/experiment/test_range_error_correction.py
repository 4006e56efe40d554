"""What is done to ranges: known less well as asked for, and never moved out of all reason."""

from typing import Any

import pytest
import torch

from navlearn.errors import ConfigError, FilterDivergedError
from navlearn.experiment import range_error_correction, range_error_method
from navlearn.experiment.range_error_correction import FARTHEST, told_wider
from navlearn.experiment.range_error_method import RangeErrorMethod
from navlearn.experiment.tight_filter_runs import TightFilterRuns
from navlearn.gnss.range_noise import RangeNoiseOptions, range_noise, range_variance
from navlearn.logs.synthetic import simulate_drive
from navlearn.outages.known_log import known_log
from navlearn.outages.replay import Solution
from navlearn.outages.schedule import Outage
from navlearn.recipe import Recipe
from navlearn.recipe.range_error_spec import RangeErrorSpec
from navlearn.states import SatelliteRanges


@pytest.mark.parametrize("told", [0.0, 0.4])
@pytest.mark.parametrize("factor", [1.0, 2.0])
def test_what_is_added_is_what_was_asked_for(told: float, factor: float) -> None:
    options = RangeNoiseOptions(told_factor=factor)
    cn0 = torch.tensor([[22.0, 30.0, 45.0, 52.0]], dtype=torch.float64)
    one = torch.ones_like(cn0)
    vector = one.unsqueeze(-1).expand(*one.shape, 3)
    ranges = SatelliteRanges(
        vector, vector, one, one, 0.5 * one, cn0, told * one, one, one.long(), one, one
    )

    def variance(std: torch.Tensor) -> torch.Tensor:
        return range_variance(range_noise(options), ranges.elevation, cn0, std)

    further = variance(told_wider(ranges, options, 3.0)) - variance(ranges.std_range)
    torch.testing.assert_close(further, 9.0 * one)
    with pytest.raises(ConfigError, match="told_factor"):
        told_wider(ranges, RangeNoiseOptions(told_factor=0.0), 3.0)


def solved(**safeguard: Any) -> Solution:
    """What a plain model makes of a short drive."""
    log = simulate_drive(
        profile="town",
        grade="tactical",
        duration=220.0,
        seed=11,
        imu_rate_hz=10.0,
        satellites="open_sky",
    ).log
    assert log.ranges is not None
    heard = log.ranges[(log.ranges["t"] - 180.0).abs() < 0.5]["satellite"].unique()
    outage = Outage(180.0, 30.0, tuple(heard[:3]))
    runs = TightFilterRuns(
        Recipe.model_validate({"name": "a", "log": {"path": "a"}, "methods": ["tc_ekf"]})
    )
    spec = RangeErrorSpec.model_validate({"name": "m", "structure": "held", "safeguard": safeguard})
    return RangeErrorMethod(runs, spec).predict(known_log(log, outage), outage)


def test_a_model_that_runs_away_makes_wild_ranges_and_no_error(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    predict = range_error_correction.predict_range_errors

    def running_away(*given: Any) -> Any:
        found = predict(*given)
        rows = torch.arange(len(found.error), dtype=torch.float64).unsqueeze(-1)
        away = 10.0 ** (rows + torch.arange(found.error.shape[1]))
        return found._replace(error=torch.where(found.known, away, 0.0))

    monkeypatch.setattr(range_error_correction, "predict_range_errors", running_away)
    found = solved(gate=False)
    assert found.notes["largest_correction_m"] == FARTHEST
    assert int(str(found.notes["ranges_refused"])) > 0
    assert bool(found.table[["lat", "lon"]].notna().all().all())


def test_a_model_with_which_an_emulated_outage_is_lost_is_refused(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    def lost(*_: Any) -> Any:
        raise FilterDivergedError("lost in an emulated outage")

    monkeypatch.setattr(range_error_method, "judged", lost)
    found = solved()
    assert found.notes["used"] is False
    assert found.notes["reason"] == "lost in an emulated outage"
