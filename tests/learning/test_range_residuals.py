"""What is kept of a filter's ranges, and its grid against plain loops."""

import math

import pytest
import torch

from navlearn.errors import ConfigError, ShapeError
from navlearn.filters.belief import Belief
from navlearn.filters.tight_belief import TightBelief
from navlearn.frames import ecef_from_geodetic, enu_from_ecef_matrix
from navlearn.fusion.measurements import Verdict
from navlearn.fusion.tight.history import TightHistory
from navlearn.learning.range_record import RangeRecord, joined, range_record
from navlearn.learning.range_residuals import (
    ResidualOptions,
    mean_by_row,
    residual_series,
    tracked_for,
)
from navlearn.states import NavState, SatelliteRanges, Trajectory

SATELLITES, STATES = 6, 7
LAT, LON = 0.8, 0.2
SYSTEM = torch.tensor([0, 0, 0, 1, 0, 1])


def drawn(*shape: int, seed: int = 0) -> torch.Tensor:
    return torch.randn(*shape, generator=torch.Generator().manual_seed(seed)).double()


def satellites() -> tuple[torch.Tensor, torch.Tensor]:
    """Unit vectors ENU, and positions 2e7 m away along them."""
    azimuth = torch.linspace(0.0, 5.5, SATELLITES).double()
    elevation = torch.linspace(0.3, 1.4, SATELLITES).double()
    level = torch.cos(elevation)
    unit = torch.stack(
        (level * torch.sin(azimuth), level * torch.cos(azimuth), torch.sin(elevation)), -1
    )
    lat, lon = torch.tensor([LAT]).double(), torch.tensor([LON]).double()
    car = ecef_from_geodetic(lat, lon, torch.zeros(1).double())
    return unit, car + 2e7 * unit @ enu_from_ecef_matrix(lat, lon)[0]


def updated(
    prior: torch.Tensor, rows: torch.Tensor, noise: torch.Tensor, innovation: torch.Tensor
) -> tuple[torch.Tensor, torch.Tensor]:
    """Correction and covariance of a textbook update with some rows."""
    gain = prior @ rows.T @ torch.linalg.inv(rows @ prior @ rows.T + torch.diag(noise))
    return gain @ innovation, prior - gain @ rows @ prior


def one_update(refused: int) -> tuple[TightHistory, SatelliteRanges]:
    """A history of two blocks, one of them with a reception."""
    unit, position = satellites()
    rows = torch.zeros(SATELLITES, STATES).double()
    rows[:, :3], rows[:, 4] = -unit, 1.0
    rows[SYSTEM == 1, 6] = 1.0
    root = drawn(STATES, STATES, seed=1)
    prior = root @ root.T + torch.eye(STATES).double()
    noise = torch.linspace(1.0, 9.0, SATELLITES).double()
    innovation = 3.0 * drawn(SATELLITES, seed=2)
    used = torch.arange(SATELLITES) != refused
    shift, after = updated(prior, rows[used], noise[used], innovation[used])
    verdict = torch.full((2, 2 * SATELLITES), int(Verdict.ABSENT))
    verdict[1, :SATELLITES] = int(Verdict.ACCEPTED)
    verdict[1, refused] = int(Verdict.REFUSED_BY_GATE)

    def two(row: torch.Tensor) -> torch.Tensor:
        return torch.stack((torch.full_like(row, torch.nan), row))

    def belief(covariance: torch.Tensor) -> TightBelief[Belief]:
        zeros = torch.zeros(2).double()
        return TightBelief(
            Belief(NavState(zeros, zeros, zeros, zeros), zeros, zeros, zeros, zeros, zeros),
            torch.zeros(2, 3).double(),
            two(covariance),
            zeros,
        )

    flat = torch.zeros(4).double()
    history = TightHistory(
        end=torch.tensor([1, 3]),
        reception=torch.tensor([-1, 0]),
        prior=belief(prior),
        belief=belief(after),
        trajectory=Trajectory(flat + LAT, flat + LON, flat, flat, flat + 3.0, flat + 4.0, flat),
        innovation=two(innovation),
        rate_innovation=two(innovation),
        residual=two(innovation - rows @ shift),
        spread=two(((rows @ prior) * rows).sum(-1) + noise),
        nis=flat,
        verdict=verdict,
        own_innovation=flat,
        own_nis=flat,
        own_verdict=flat,
        resets=torch.zeros(2),
        method="exact",
        passes=1,
    )
    ones = torch.ones(1, SATELLITES).double()
    ranges = SatelliteRanges(
        position.unsqueeze(0), position.unsqueeze(0), 2e7 * ones, ones, 0.5 * ones, 45.0 * ones,
        ones, ones, SYSTEM, ones, ones,
    )  # fmt: skip
    return history, ranges


def test_a_record_tells_what_the_filter_took_and_what_it_left() -> None:
    history, ranges = one_update(refused=4)
    record = range_record(history, ranges, torch.tensor([7.0]).double())
    assert record.t.tolist() == [7.0]
    assert record.reception.tolist() == [0]
    torch.testing.assert_close(record.residual, history.residual[1:])
    torch.testing.assert_close(record.spread, history.spread[1:].sqrt())
    torch.testing.assert_close(record.predicted + record.innovation, ranges.pseudorange)
    assert record.taken[0].tolist() == [True] * 4 + [False, True]
    unit, _ = satellites()
    toward = unit[:, 0] * 3.0 + unit[:, 1] * 4.0
    torch.testing.assert_close(record.along_sight[0], toward)
    torch.testing.assert_close(record.speed[0], torch.full((SATELLITES,), 5.0).double())


def test_a_history_of_other_ranges_is_refused() -> None:
    history, ranges = one_update(refused=0)
    with pytest.raises(ShapeError, match="at most 0 receptions"):
        range_record(history, ranges, torch.zeros(0).double())


def record_of(t: torch.Tensor, residual: torch.Tensor) -> RangeRecord:
    """A record in which every channel is told apart by its size."""
    heard = torch.isfinite(residual)
    channels = {
        name: torch.where(heard, residual * k, torch.nan)
        for k, name in enumerate(RangeRecord._fields)
    }
    return RangeRecord(**{**channels, "t": t, "taken": heard, "residual": residual})


def test_rows_are_even_and_do_not_reach_across_the_start() -> None:
    t = torch.tensor([0.02, 0.99, 2.03, 4.01, 4.3, 4.98, 6.01, 7.0]).double()
    residual = drawn(8, SATELLITES)
    residual[4, 2:] = torch.nan
    record = record_of(t, residual)
    options = ResidualOptions(inputs=("cn0", "speed"), min_satellites=4)
    series = residual_series(record, 5.5, options)
    assert series.row.tolist() == [0, 1, 2, 4, 4, 5, 6, 7]
    assert series.origin == 6
    assert series.step == 1.0
    assert bool(torch.isnan(series.target[3]).all())  # a gap stays a gap
    assert bool(torch.isnan(series.target[6:]).all())  # nothing in the outage is a target
    # the fifth reception had two satellites only and is no target, but it is an input
    torch.testing.assert_close(series.target[4], residual[3])
    torch.testing.assert_close(series.inputs[4, :, 0], record.cn0[3:5].nanmean(0))
    torch.testing.assert_close(series.inputs[6:, :, 1], record.speed[6:])


def test_refused_satellites_are_no_targets() -> None:
    record = record_of(torch.arange(3).double(), drawn(3, SATELLITES))
    taken = record.taken.clone()
    taken[1, 0] = False
    series = residual_series(record._replace(taken=taken), 9.0, ResidualOptions())
    assert bool(torch.isnan(series.target[1, 0]))
    assert int(torch.isfinite(series.target).sum()) == 3 * SATELLITES - 1


def test_mean_by_row_leaves_out_what_is_missing() -> None:
    values = torch.tensor([1.0, 3.0, torch.nan, torch.nan]).double()
    found = mean_by_row(values, torch.tensor([0, 0, 0, 2]), 3)
    assert float(found[0]) == 2.0
    assert bool(torch.isnan(found[1:]).all())


def test_age_counts_from_where_a_satellite_was_lost() -> None:
    t = torch.tensor([0.0, 1.0, 2.0, 3.0, 4.0, 5.0, 6.0, 7.0]).double()
    there = torch.tensor([1, 1, 0, 1, 0, 0, 1, 1]).bool().unsqueeze(-1)
    age = tracked_for(t, there)[:, 0].tolist()
    expected = [0.0, 1.0, math.nan, 3.0, math.nan, math.nan, 0.0, 1.0]
    assert age == pytest.approx(expected, nan_ok=True)


def test_records_join_in_time() -> None:
    first, second = (record_of(torch.arange(3).double() + k, drawn(3, 2, seed=k)) for k in (0, 3))
    both = joined(first, second)
    assert both.t.tolist() == [0.0, 1.0, 2.0, 3.0, 4.0, 5.0]
    torch.testing.assert_close(both.residual[3:], second.residual)


@pytest.mark.parametrize(
    ("changed", "said"),
    [
        ({"inputs": ("elevatoin",)}, "unknown input 'elevatoin'"),
        ({"min_satellites": 3}, "fewer than 4"),
        ({"step": 0.0}, "must be positive"),
    ],
)
def test_options_say_what_is_wrong(changed: dict[str, object], said: str) -> None:
    with pytest.raises(ConfigError, match=said):
        ResidualOptions(**changed)  # type: ignore[arg-type]
