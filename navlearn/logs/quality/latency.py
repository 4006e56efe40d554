"""Latency between the streams of a log, with the scale and bias that come with it.

A latency is **positive where a stream is stamped late**: a sample stamped t with latency d
describes what the other stream calls t − d. Three comparisons tell it:

* direction of motion (or reference azimuth) against the turned angle of the gyro;
* odometer speed against GNSS or reference speed;
* growth of a speed against the integral of the forward specific force.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal, NamedTuple

import numpy as np
import pandas as pd

from navlearn.errors import ConfigError
from navlearn.logs.drive_log import DriveLog
from navlearn.logs.quality.comparisons import (
    Comparison,
    gain_comparison,
    speed_comparison,
    turn_comparison,
)
from navlearn.logs.quality.delay_fit import DelayFit, fit_delay
from navlearn.logs.quality.signals import in_order

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


class Disagreement(str):
    """A reason why a latency is not observable that a moving log should not give."""


@dataclass(frozen=True, kw_only=True)
class Latency:
    """How late one stream is stamped against another, and how their values relate.

    Attributes:
        delay: Latency at the mean time of the samples used, s, positive where stamped late.
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
        reach = (self.at_end - self.delay) / self.drift if self.drift else 0.0
        return Estimate(self.at_end, float(np.hypot(self.std, self.drift_std * reach)))


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
        return Disagreement(f"the two hardly agree (correlation {fit.correlation:.2f})")
    if fit.at_edge:
        return Disagreement(f"no agreement found within ±{limit:.2g} s")
    if fit.delay_std > 0.15:
        return f"the motion tells it only to {fit.delay_std:.2g} s"
    bias = len(fit.coefficients) > 1
    return Latency(
        delay=fit.delay,
        std=fit.delay_std,
        drift=fit.drift,
        drift_std=fit.drift_std,
        at_start=fit.delay + fit.drift * (float(laid.t[0]) - fit.middle),
        at_end=fit.delay + fit.drift * (float(laid.t[-1]) - fit.middle),
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


_COMPARISONS: dict[tuple[Stream, Stream], Callable[[DriveLog], Comparison | str]] = {
    ("fixes", "imu"): lambda log: turn_comparison(log, "fixes"),
    ("reference", "imu"): lambda log: turn_comparison(log, "reference"),
    ("odometer", "fixes"): lambda log: speed_comparison(log, "fixes"),
    ("odometer", "reference"): lambda log: speed_comparison(log, "reference"),
    ("odometer", "imu"): lambda log: gain_comparison(log, "odometer"),
}
