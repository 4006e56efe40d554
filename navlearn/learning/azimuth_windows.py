"""Rows of what a feed-forward filter knows of the azimuth: regressors and targets per second.

Source: [Shen2010] §3.2 and [Iqbal2020, VIII]. While fixes are there, what a filter's linear model
leaves of the azimuth error is ΔA = A_mec − δA_KF − A_gps: azimuth of the free mechanization, the
filter's prediction of its error, and course. The regressors are the filter's predictions of the
errors, which only a filter that feeds nothing back has.
"""

from typing import NamedTuple

import torch
from torch import Tensor

from navlearn.attitude import wrap_angle
from navlearn.errors import ConfigError
from navlearn.fusion.error_state import ERROR_UNITS
from navlearn.fusion.filter_model import FilterModel, difference
from navlearn.fusion.ground_velocity import BlockEnd
from navlearn.fusion.history import FilterHistory
from navlearn.fusion.measurements import Kind, refused
from navlearn.fusion.sensor_errors import odometer_acceleration
from navlearn.states import FixTiming, GnssFix, RissSample

READINGS = ("angle", "rate")
"""Readings of [Shen2010] Eq. (9): §3.2 trains an angle, the equation itself models a rate."""


class AzimuthRows(NamedTuple):
    """N rows in order of time, a step apart.

    Attributes:
        time: End of each row after the first sample's begin, s, shape (N,).
        inputs: Predicted errors of the free mechanization, in the order of the filter's error
            state, shape (N, n).
        azimuth: Azimuth A_mec of the free mechanization, rad, shape (N,).
        predicted: Its error δA_KF as predicted, rad, shape (N,).
        updated: The same after what was measured then, rad, shape (N,).
        course: Azimuth A_gps by GNSS course, rad; any value where there is none, shape (N,).
        has_course: 1.0 where there is one, shape (N,).
    """

    time: Tensor
    inputs: Tensor
    azimuth: Tensor
    predicted: Tensor
    updated: Tensor
    course: Tensor
    has_course: Tensor


def predicted_errors(model: FilterModel, history: FilterHistory, samples: RissSample) -> Tensor:
    """Return what a feed-forward filter predicted of the errors before each update.

    Args:
        model: The filter.
        history: Its run over one drive.
        samples: What it ran on, shape (T,) each.

    Returns:
        Free mechanization minus prediction, in the order of the error state, shape (K, n).

    Raises:
        ConfigError: The filter feeds its estimates back, which leaves nothing to predict.
    """
    if model.closed:
        raise ConfigError(
            "azimuth rows: the filter feeds its errors back, so its predictions of them are zero; "
            "run it with feedback='open'"
        )
    last = RissSample(*(channel[history.end] for channel in samples))
    push = odometer_acceleration(samples.dt, samples.speed, history.end)
    moved = difference(model, history.belief, history.prior, BlockEnd(last, push))
    return history.error + moved


def courses(
    model: FilterModel,
    history: FilterHistory,
    samples: RissSample,
    fixes: GnssFix,
    timing: FixTiming,
    slowest: float,
) -> tuple[Tensor, Tensor]:
    """Return the azimuth that GNSS tells at the end of every block, and where it tells one.

    Course of the antenna, less its swing about the car, carried on to the block's end by the
    gyro. Slow fixes tell none, nor do those whose velocity the filter's gate refused.

    Args:
        model: The filter.
        history: Its run over one drive.
        samples: What it ran on, shape (T,) each.
        fixes: Its fixes, shape (M,) each.
        timing: Where they fall, shape (M,) each.
        slowest: Slowest speed, by GNSS and by the odometer, at which a course counts, m/s.

    Returns:
        Azimuth, rad, and 1.0 where there is one, shape (K,) each.
    """
    zero = torch.zeros_like(history.belief.state.azimuth)
    if timing.index.numel() == 0:
        return zero, zero
    at = history.fix.clamp(min=0)
    v_e, v_n = fixes.v_e[at], fixes.v_n[at]
    odometer, rate = samples.speed[history.end], samples.yaw_rate[history.end]
    out = refused(history.verdict[:, Kind.VELOCITY])
    there = (history.fix >= 0) & (fixes.has_velocity[at] > 0.5) & ~out
    there = there & (torch.minimum(torch.hypot(v_e, v_n), odometer) > slowest)
    right, forward, _ = model.options.lever_arm
    swing = torch.atan2(-rate * forward, odometer + rate * right)
    course = torch.atan2(v_e, v_n) - swing - rate * timing.delay[at]
    return torch.where(there, course, zero), there.to(zero)


def azimuth_rows(
    model: FilterModel,
    history: FilterHistory,
    samples: RissSample,
    fixes: GnssFix,
    timing: FixTiming,
    *,
    step: float,
    slowest: float,
    origin: int | None = None,
) -> AzimuthRows:
    """Return a row per step over the run of a feed-forward filter.

    Args:
        model: The filter.
        history: Its run over one drive.
        samples: What it ran on, shape (T,) each.
        fixes: Its fixes, shape (M,) each.
        timing: Where they fall, shape (M,) each.
        step: Time between rows, s.
        slowest: Slowest speed at which a course counts, m/s.
        origin: Sample at whose end a row must fall; None stands for the last one.

    Returns:
        The rows; a row is the block that ends nearest to it, one with a fix before others.
    """
    clock = torch.cumsum(samples.dt, -1)
    ends = clock[history.end]
    start = clock[-1] if origin is None else clock[origin]
    before = int((start - ends[0]) / step + 1e-6)
    after = int((clock[-1] - start) / step + 1e-6)
    wanted = start + step * torch.arange(-before, after + 1).to(clock)
    block = _nearest(ends, history.fix >= 0, wanted, step)
    errors = predicted_errors(model, history, samples)
    at = model.layout.azimuth
    course, there = courses(model, history, samples, fixes, timing, slowest)
    close = (ends[block] - wanted).abs() <= 0.5 * step
    # Where blocks are longer than a step one may stand for two rows; its course counts once.
    fresh = torch.nn.functional.pad(block[1:] != block[:-1], (1, 0), value=True)
    return AzimuthRows(
        ends[block],
        errors[block],
        (history.belief.state.azimuth + history.error[:, at])[block],
        errors[block, at],
        history.error[block, at],
        course[block],
        torch.where(close & fresh, there[block], 0.0),
    )


def _nearest(ends: Tensor, with_fix: Tensor, wanted: Tensor, step: float) -> Tensor:
    """Return the block that stands for each row, shape (N,)."""
    distance = (ends.unsqueeze(0) - wanted.unsqueeze(1)).abs()
    # A block without a fix is as good as one with a fix that is half a step farther away.
    return (distance + torch.where(with_fix, 0.0, 0.5 * step)).argmin(-1)


def azimuth_target(rows: AzimuthRows, reading: str, step: float = 1.0) -> tuple[Tensor, Tensor]:
    """Return what is to be learned, and where it is known.

    ``angle``: ΔA itself. ``rate``: how much faster the azimuth error grew from one row to the
    next than the filter foretold, ΔA of [Shen2010] Eq. (9).

    Args:
        rows: Rows with fixes.
        reading: ``angle`` or ``rate``.
        step: Time between rows, s.

    Returns:
        Target, rad or rad per step, zero where not known, and weights 1.0 or 0.0, shape (N,) each.

    Raises:
        ConfigError: The reading is another word.
    """
    if reading not in READINGS:
        raise ConfigError(f"azimuth target: found {reading!r}; choose {' or '.join(READINGS)}")
    left = wrap_angle(rows.azimuth - rows.predicted - rows.course)
    if reading == "angle":
        return torch.where(rows.has_course > 0.0, left, 0.0), rows.has_course
    after = wrap_angle(rows.azimuth - rows.updated - rows.course)
    grown = wrap_angle(left[1:] - after[:-1])
    known = torch.nn.functional.pad(rows.has_course[1:] * rows.has_course[:-1], (1, 0))
    rate = torch.nn.functional.pad(grown * step / torch.diff(rows.time).clamp(min=1e-9), (1, 0))
    return torch.where(known > 0.0, rate, 0.0), known


def residual_azimuth(output: Tensor, time: Tensor, reading: str, step: float = 1.0) -> Tensor:
    """Return ΔA through an outage from a model's output.

    Args:
        output: What the model says of the rows of the outage, shape (N,); the first row is the
            outage's start.
        time: Their times, s, shape (N,).
        reading: What the model was trained on; a ``rate`` is integrated from zero at the first
            row, where the filter has just been told.
        step: Time between rows, s.

    Returns:
        ΔA, rad, shape (N,).
    """
    if reading == "angle":
        return output
    grown = torch.cumsum(output[1:] * torch.diff(time) / step, -1)
    return torch.nn.functional.pad(grown, (1, 0))


def error_unit(name: str) -> str:
    """Return the unit of an error in a filter's error state.

    Args:
        name: Its name, as :func:`navlearn.fusion.error_state.error_layout` gives it.
    """
    return ERROR_UNITS.get(name, "1")
