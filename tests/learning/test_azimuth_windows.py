"""Targets of the azimuth models, against records whose residual was put in by hand."""

import pytest
import torch
from torch import Tensor

from navlearn.attitude import wrap_angle
from navlearn.errors import ConfigError
from navlearn.fusion.error_state import error_layout
from navlearn.fusion.options import GYRO_TERMS, SPEED_TERMS, EkfOptions
from navlearn.learning.azimuth_windows import (
    AzimuthRows,
    azimuth_target,
    error_unit,
    residual_azimuth,
)
from navlearn.mechanization.options import RissOptions


def rows_with(residual: Tensor, predicted: Tensor, correction: Tensor | None = None) -> AzimuthRows:
    """A car that turns through several circles; course is what is left of A_mec."""
    count = len(residual)
    time = 1.0 * torch.arange(count).double()
    azimuth = 0.2 * time
    return AzimuthRows(
        time=time,
        inputs=predicted.unsqueeze(-1),
        azimuth=azimuth,
        predicted=predicted,
        updated=predicted if correction is None else predicted + correction,
        course=wrap_angle(azimuth - predicted - residual),
        has_course=torch.ones(count).double(),
    )


def test_angle_is_the_residual_whatever_the_circle() -> None:
    residual = 0.1 * torch.sin(torch.arange(80.0).double())
    target, weight = azimuth_target(
        rows_with(residual, torch.linspace(0, 0.3, 80).double()), "angle"
    )
    torch.testing.assert_close(target, residual, atol=1e-12, rtol=0)
    assert bool((weight == 1.0).all())


def test_rate_is_what_the_filter_did_not_foretell() -> None:
    """An azimuth error of 0.01 rad/s; the filter foretells 0.004 rad/s and is corrected."""
    time = torch.arange(50.0).double()
    predicted, correction = torch.zeros(50).double(), torch.zeros(50).double()
    for k in range(1, 50):
        predicted[k] = predicted[k - 1] + correction[k - 1] + 0.004
        correction[k] = 0.3 * (0.01 * time[k] - predicted[k])
    rows = rows_with(0.01 * time - predicted, predicted, correction)
    target, weight = azimuth_target(rows, "rate")
    torch.testing.assert_close(
        target[1:], torch.full((49,), 0.006, dtype=torch.float64), atol=1e-12, rtol=0
    )
    assert weight.tolist() == [0.0] + [1.0] * 49
    # The same record with its clock at half the pace: as much grows in a step of two seconds.
    slower, _ = azimuth_target(rows._replace(time=2.0 * time), "rate", step=2.0)
    torch.testing.assert_close(slower, target, atol=1e-15, rtol=0)


def test_rows_without_course_carry_no_weight_and_no_garbage() -> None:
    rows = rows_with(torch.full((20,), 0.05).double(), torch.zeros(20).double())
    there = torch.ones(20).double()
    there[[4, 5, 11]] = 0.0
    course = torch.where(there > 0.0, rows.course, torch.nan)
    rows = rows._replace(course=course, has_course=there)
    angle, weight = azimuth_target(rows, "angle")
    assert bool(torch.isfinite(angle).all())
    assert torch.nonzero(weight == 0.0).squeeze(-1).tolist() == [4, 5, 11]
    rate, weight = azimuth_target(rows, "rate")
    assert bool(torch.isfinite(rate).all())
    assert torch.nonzero(weight == 0.0).squeeze(-1).tolist() == [0, 4, 5, 6, 11, 12]


def test_a_rate_is_integrated_from_the_last_fix_on() -> None:
    time = torch.tensor([10.0, 11.0, 12.1, 13.0]).double()
    rate = torch.tensor([9.0, 0.1, 0.2, -0.1]).double()
    expected = torch.tensor([0.0, 0.1, 0.1 + 0.22, 0.1 + 0.22 - 0.09]).double()
    torch.testing.assert_close(residual_azimuth(rate, time, "rate"), expected)
    torch.testing.assert_close(residual_azimuth(0.5 * rate, time, "rate", step=0.5), expected)
    assert residual_azimuth(rate, time, "angle") is rate


def test_every_error_of_every_filter_has_its_unit() -> None:
    options = EkfOptions(
        gyro_terms=GYRO_TERMS,
        speed_terms=SPEED_TERMS,
        mechanization=RissOptions(dimensions=3),
    )
    units = {name: error_unit(name) for name in error_layout(options).names}
    assert units["gyro_bias"] == "rad/s"
    assert units["pitch_bias"] == units["azimuth"] == "rad"
    without = {name for name, unit in units.items() if unit == "1"}
    assert without == {"gyro_scale", "gyro_abs_scale", "speed_scale"}
    names = error_layout(EkfOptions(model="shen2010")).names
    assert [error_unit(name) for name in names[3:6]] == ["m/s"] * 3
    assert "1" not in map(error_unit, names)


def test_an_unknown_reading_is_refused() -> None:
    rows = rows_with(torch.zeros(5).double(), torch.zeros(5).double())
    with pytest.raises(ConfigError, match="choose angle or rate"):
        azimuth_target(rows, "degrees")
