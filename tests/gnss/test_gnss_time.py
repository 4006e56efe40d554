"""Weeks and leap seconds."""

from datetime import UTC, datetime, timedelta

import pytest
import torch

from navlearn.gnss.gnss_time import (
    gps_from_utc,
    half_week,
    leap_seconds,
)

BEGIN = datetime(1980, 1, 6, tzinfo=UTC)
# Bulletin C: the days before which a second was put in since GPS began
LEAPS = [
    *((1981, 7), (1982, 7), (1983, 7), (1985, 7), (1988, 1), (1990, 1), (1991, 1), (1992, 7)),
    *((1993, 7), (1994, 7), (1996, 1), (1997, 7), (1999, 1), (2006, 1), (2009, 1), (2012, 7)),
    *((2015, 7), (2017, 1)),
]


def utc(*calendar: int) -> float:
    return (datetime(*calendar, tzinfo=UTC) - BEGIN) / timedelta(seconds=1)


def seconds(value: float) -> torch.Tensor:
    return torch.tensor(value, dtype=torch.float64)


@pytest.mark.parametrize(("count", "month"), list(enumerate(LEAPS)))
def test_leap_seconds_by_the_calendar(count: int, month: tuple[int, int]) -> None:
    midnight = utc(*month, 1)
    before, after = gps_from_utc(seconds(midnight - 1.0)), gps_from_utc(seconds(midnight))
    assert float(before) == midnight - 1.0 + count
    assert float(after) == midnight + count + 1
    assert float(leap_seconds(before)) == count
    assert float(leap_seconds(after)) == count + 1


def test_a_day_that_is_known() -> None:
    found = gps_from_utc(seconds(utc(2023, 6, 29, 11, 15, 0)))
    of_week = 4 * 86400.0 + 11 * 3600 + 15 * 60 + 18
    assert float(found) == 2268 * 604800.0 + of_week


def test_half_a_week_either_way() -> None:
    found = half_week(torch.tensor([0.0, 302399.0, 302400.0, -302400.0, 604790.0, -604790.0]))
    torch.testing.assert_close(
        found, torch.tensor([0.0, 302399.0, -302400.0, -302400.0, -10.0, 10.0])
    )
