"""Latency between the streams of a log, with the scale and bias that come with it.

A latency is **positive where a stream is stamped late**: a sample stamped t with latency d
describes what the other stream calls t − d. Three comparisons tell it:

* direction of motion (or reference azimuth) against the turned angle of the gyro;
* odometer speed against GNSS or reference speed;
* growth of a speed against the integral of the forward specific force.

Direction of motion is that of the antenna: ahead of the rear axle it turns early at low speed,
and side slip turns it late at high speed, some 0.05 s each; the forces know neither.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal, NamedTuple

import numpy as np
import pandas as pd

from navlearn.errors import ConfigError
from navlearn.logs.drive_log import DriveLog
from navlearn.logs.quality.delay_fit import DelayFit, Design, fit_delay
from navlearn.logs.quality.signals import (
    Array,
    column,
    in_order,
    integral,
    median_interval,
    resampled,
    track_of,
)

Stream = Literal["imu", "odometer", "fixes", "reference"]

LIMIT = 2.0
"""Largest latency searched, s."""


class Estimate(NamedTuple):
    """A number and how well it is known.

    Attributes:
        value: The estimate.
        std: Its standard deviation, in the same unit.
    """

    value: float
    std: float


@dataclass(frozen=True, kw_only=True)
class Latency:
    """How late one stream is stamped against another, and how their values relate.

    Attributes:
        delay: Latency at the middle of the samples used, s, positive where stamped late.
        std: Its standard deviation, s.
        drift: Growth of the latency, s/s; zero unless asked for.
        drift_std: Its standard deviation, s/s.
        at_start: Latency at the first sample used, s.
        at_end: Latency at the last sample used, s.
        scale: What the named stream reports per unit of the other.
        scale_std: Its standard deviation.
        offset: What it reports beyond that, in rad/s or m/s², zero for speeds.
        offset_std: Its standard deviation.
        correlation: Between the two after the fit.
        residual: Robust standard deviation of what remains (rad, or m/s).
        samples: Comparisons used.
    """

    delay: float
    std: float
    drift: float
    drift_std: float
    at_start: float
    at_end: float
    scale: float
    scale_std: float
    offset: float
    offset_std: float
    correlation: float
    residual: float
    samples: int

    @property
    def drifts(self) -> bool:
        """Whether a growth was fitted and stands out of its uncertainty fivefold."""
        return abs(self.drift) > 5.0 * self.drift_std

    @property
    def last(self) -> Estimate:
        """Latency at the last sample used, s."""
        reach = 0.5 * (self.at_end - self.at_start) / self.drift if self.drift else 0.0
        return Estimate(self.at_end, float(np.hypot(self.std, self.drift_std * reach)))


@dataclass(frozen=True, kw_only=True)
class Comparison:
    """What is laid side by side: observations, and the regressors for any delay."""

    t: Array
    observed: Array
    weight: Array
    design: Design
    overlap: int = 1


def latency_between(
    log: DriveLog,
    stream: Stream,
    against: Stream,
    *,
    until: float | None = None,
    with_drift: bool = False,
) -> Latency | None:
    """Return how late one stream is stamped against another, None where that cannot be told.

    Args:
        log: The log; rows out of order are put in order first.
        stream: The stream in question.
        against: The stream whose clock counts.
        until: Nothing at or after this time is used, s.
        with_drift: Whether to fit a linear growth of the latency.

    Raises:
        ConfigError: For a pair that has nothing in common to compare.
    """
    found = compare(ordered(log, until=until), stream, against, with_drift=with_drift)
    return found if isinstance(found, Latency) else None


def ordered(log: DriveLog, *, until: float | None = None) -> DriveLog:
    """Return the log with every table in order and cut before a time."""
    end = np.inf if until is None else until

    def cut(table: pd.DataFrame) -> pd.DataFrame:
        clean = in_order(table)
        return clean[clean["t"] < end]

    return log.with_tables({name: cut(table) for name, table in log.tables().items()})


def compare(
    log: DriveLog, stream: Stream, against: Stream, *, with_drift: bool = False
) -> Latency | str:
    """Return the latency of one stream against another, or why it is not observable.

    Args:
        log: The log, in order.
        stream: The stream in question.
        against: The stream whose clock counts.
        with_drift: Whether to fit a linear growth of the latency.

    Raises:
        ConfigError: For a pair that has nothing in common to compare.
    """
    if (stream, against) in _COMPARISONS:
        laid = _COMPARISONS[stream, against](log)
        if isinstance(laid, str):
            return laid
        return fitted_latency(laid, with_drift=with_drift)
    if (against, stream) in _COMPARISONS:
        found = compare(log, against, stream, with_drift=with_drift)
        return found if isinstance(found, str) else _reversed(found)
    pairs = ", ".join(f"{a} against {b}" for a, b in _COMPARISONS)
    raise ConfigError(
        f"latency_between: nothing compares {stream!r} with {against!r}; choose one of: {pairs}"
    )


def fitted_latency(laid: Comparison, *, with_drift: bool = False) -> Latency | str:
    """Return the latency that makes the two sides of a comparison agree, or why none does."""
    if len(laid.t) < 20:
        return f"only {len(laid.t)} samples in motion to compare, 20 needed"
    span = float(laid.t[-1] - laid.t[0])
    limit = min(LIMIT, span / 8.0)
    fit = fit_delay(
        laid.t,
        laid.observed,
        laid.design,
        weight=laid.weight,
        limit=limit,
        with_drift=with_drift,
        overlap=laid.overlap,
    )
    if fit is None:
        return "too few samples, or nothing that changes enough to tell a delay"
    return _judged(fit, laid, limit)


def _judged(fit: DelayFit, laid: Comparison, limit: float) -> Latency | str:
    if abs(fit.correlation) < 0.4:
        return f"the two hardly agree (correlation {fit.correlation:.2f})"
    if fit.at_edge:
        return f"no agreement found within ±{limit:g} s"
    if fit.delay_std > 0.15:
        return f"the motion tells it only to {fit.delay_std:.2g} s"
    centre = 0.5 * float(laid.t[-1] - laid.t[0])
    bias = len(fit.coefficients) > 1
    return Latency(
        delay=fit.delay,
        std=fit.delay_std,
        drift=fit.drift,
        drift_std=fit.drift_std,
        at_start=fit.delay - fit.drift * centre,
        at_end=fit.delay + fit.drift * centre,
        scale=float(fit.coefficients[0]),
        scale_std=float(fit.coefficient_std[0]),
        offset=float(fit.coefficients[1]) if bias else 0.0,
        offset_std=float(fit.coefficient_std[1]) if bias else 0.0,
        correlation=fit.correlation,
        residual=fit.residual,
        samples=fit.samples,
    )


def _reversed(found: Latency) -> Latency:
    return Latency(
        delay=-found.delay,
        std=found.std,
        drift=-found.drift,
        drift_std=found.drift_std,
        at_start=-found.at_start,
        at_end=-found.at_end,
        scale=1.0 / found.scale,
        scale_std=found.scale_std / found.scale**2,
        offset=-found.offset / found.scale,
        offset_std=found.offset_std / abs(found.scale),
        correlation=found.correlation,
        residual=found.residual,
        samples=found.samples,
    )


def turn_comparison(
    log: DriveLog, table: Literal["fixes", "reference"], *, gyro: str = "gyro_z"
) -> Comparison | str:
    """Lay the turns of fixes or reference beside the turned angle of a gyro.

    Args:
        log: The log, in order.
        table: Which directions are observed.
        gyro: Column of ``imu`` that is taken as the yaw rate.

    Returns:
        Observed: change of heading over about a second. Regressors: turned angle, time.
    """
    rows = log.fixes if table == "fixes" else log.reference
    if rows is None or len(rows) < 3:
        return f"the log has no {table}"
    t = column(log.imu, "t")
    if len(t) < 3 or not np.any(np.isfinite(column(log.imu, gyro))):
        return f"the log has no {gyro}"
    track = track_of(rows)
    t_h, heading, speed = track.t_v, track.heading, track.speed
    azimuth = column(rows, "azimuth")
    if np.count_nonzero(np.isfinite(azimuth)) > 0.5 * len(rows):
        known = np.isfinite(azimuth)
        t_h, heading = column(rows, "t")[known], -np.unwrap(azimuth[known])
        speed = np.interp(t_h, track.t_v, track.speed) if len(track.t_v) else np.zeros(len(t_h))
    if len(t_h) < 3:
        return f"the {table} hold no direction of motion"
    lag = max(1, round(1.0 / median_interval(t_h)))
    slow = 3.0 if track.measured else 5.0
    first, last = slice(None, -lag), slice(lag, None)
    pace = np.minimum(speed[first], speed[last])
    near = (t_h[last] - t_h[first]) < 2.5 * lag * median_interval(t_h)
    used = near & (pace > slow)
    a, b = t_h[first][used], t_h[last][used]
    angle = integral(log, gyro)

    def design(delay: Array) -> Array:
        turned = _at(b - delay, t, angle) - _at(a - delay, t, angle)
        return np.stack((turned, b - a), axis=-1)

    return Comparison(
        t=0.5 * (a + b),
        observed=heading[last][used] - heading[first][used],
        weight=np.minimum(pace[used], 15.0) / 15.0,
        design=design,
        overlap=lag,
    )


def speed_comparison(log: DriveLog, table: Literal["fixes", "reference"]) -> Comparison | str:
    """Lay the odometer's speed beside that of fixes or reference.

    Returns:
        Observed: odometer speed in motion. Regressor: the other speed.
    """
    rows = log.fixes if table == "fixes" else log.reference
    t, speed = _speeds(log, "odometer")
    if len(t) < 3:
        return "the log has no odometer"
    if rows is None or len(rows) < 3:
        return f"the log has no {table}"
    track = track_of(rows)
    longest = 2.5 * median_interval(track.t_v)
    moving = np.abs(speed) > 1.0
    t, speed = t[moving], speed[moving]

    def design(delay: Array) -> Array:
        return resampled(track.t_v, track.speed, t - delay, longest=longest)[:, None]

    return Comparison(t=t, observed=speed, weight=np.ones(len(t)), design=design)


def gain_comparison(
    log: DriveLog, table: Literal["odometer", "fixes"], *, along: str = "accel_y"
) -> Comparison | str:
    """Lay the growth of a speed beside the integral of forward specific force.

    Args:
        log: The log, in order.
        table: Whose speed is observed.
        along: Column of ``imu`` that is taken as the forward specific force.

    Returns:
        Observed: gain of speed over about a second. Regressors: integrated force, time.
    """
    t = column(log.imu, "t")
    if len(t) < 3 or not np.any(np.isfinite(column(log.imu, along))):
        return f"the log has no {along}"
    t_o, speed = _speeds(log, table)
    if len(t_o) < 3:
        return f"the log has no speeds of the {table}"
    lag = max(1, round(1.0 / median_interval(t_o)))
    a, b = t_o[:-lag], t_o[lag:]
    near = (b - a) < 2.5 * lag * median_interval(t_o)
    used = near & (np.maximum(np.abs(speed[:-lag]), np.abs(speed[lag:])) > 1.0)
    a, b = a[used], b[used]
    velocity = integral(log, along)

    def design(delay: Array) -> Array:
        gained = _at(b - delay, t, velocity) - _at(a - delay, t, velocity)
        return np.stack((gained, b - a), axis=-1)

    return Comparison(
        t=0.5 * (a + b),
        observed=(speed[lag:] - speed[:-lag])[used],
        weight=np.ones(len(a)),
        design=design,
        overlap=lag,
    )


def _speeds(log: DriveLog, table: Literal["odometer", "fixes"]) -> tuple[Array, Array]:
    if table == "fixes":
        track = track_of(log.fixes)
        return track.t_v, track.speed
    speed = column(log.odometer, "speed")
    known = np.isfinite(speed)
    return column(log.odometer, "t")[known], speed[known]


def _at(when: Array, t: Array, x: Array) -> Array:
    return np.interp(when, t, x, left=np.nan, right=np.nan)


_COMPARISONS: dict[tuple[Stream, Stream], Callable[[DriveLog], Comparison | str]] = {
    ("fixes", "imu"): lambda log: turn_comparison(log, "fixes"),
    ("reference", "imu"): lambda log: turn_comparison(log, "reference"),
    ("odometer", "fixes"): lambda log: speed_comparison(log, "fixes"),
    ("odometer", "reference"): lambda log: speed_comparison(log, "reference"),
    ("odometer", "imu"): lambda log: gain_comparison(log, "odometer"),
}
