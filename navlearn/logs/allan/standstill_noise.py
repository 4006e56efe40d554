"""What the axes of an IMU do while the car stands: noise of each, and what spoils it."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.signal import welch

from navlearn.errors import ConfigError, LogError
from navlearn.logs.allan.deviation import AllanCurve, allan_curve
from navlearn.logs.allan.stretch import AXES, Stretch, axis_samples, moving_time, stretch_of
from navlearn.logs.allan.terms import NoiseTerms, noise_terms
from navlearn.logs.drive_log import DriveLog
from navlearn.logs.imu_means import known_samples
from navlearn.logs.interval_means import FloatArray
from navlearn.logs.nearest import nearest_hint

VIBRATION = 0.2
"""A line that holds this share of an axis's power is worth a word."""

MOVES = 1.0
"""A car that moves for so long in a stretch is worth a word, s."""

LOWEST_LINE = 2.0
"""Below this frequency a line is drift, not vibration, Hz."""


@dataclass(frozen=True, kw_only=True)
class AxisNoise:
    """One axis at rest.

    Attributes:
        axis: Column of the IMU table.
        curve: Its Allan deviation, rad/s or m/s².
        terms: Its noise.
        notes: What a reader should know of it.
    """

    axis: str
    curve: AllanCurve
    terms: NoiseTerms
    notes: tuple[str, ...]

    @property
    def is_gyro(self) -> bool:
        """Whether it is a gyro."""
        return self.axis.startswith("gyro")


@dataclass(frozen=True, kw_only=True)
class StandstillNoise:
    """An IMU at rest.

    Attributes:
        log: The log's name.
        stretch: Where it stood.
        rate_hz: Samples per second.
        axes: Its axes, gyros first.
        left_out: Why an axis that the log has is not among them, by axis.
    """

    log: str
    stretch: Stretch
    rate_hz: float
    axes: tuple[AxisNoise, ...]
    left_out: dict[str, str]

    def axis(self, name: str) -> AxisNoise | None:
        """Return an axis by its name, or None where it is not told."""
        return next((one for one in self.axes if one.axis == name), None)


def standstill_noise(
    log: DriveLog,
    *,
    start: float | None = None,
    stop: float | None = None,
    axes: Sequence[str] | None = None,
    confidence: float = 0.95,
) -> StandstillNoise:
    """Return the noise of an IMU over a stretch in which the car stands.

    Args:
        log: Drive.
        start: First time of the stretch, s; without start and stop the longest standstill serves.
        stop: Last time of the stretch, s.
        axes: Columns of the IMU table that must be told; None takes all that can be.
        confidence: Share of intervals that shall hold the truth.

    Raises:
        ConfigError: An axis is unknown.
        LogError: The stretch is too short, or an axis has gaps or always reads the same.
        MissingExtraError: allantools is not installed.
    """
    for axis in axes or ():
        if axis not in AXES:
            raise ConfigError(
                f"axis: found {axis!r}{nearest_hint(axis, AXES)}; choose among {', '.join(AXES)}"
            )
    stretch = stretch_of(log, start, stop)
    moving = _moving(moving_time(log, stretch))
    told: list[AxisNoise] = []
    rates: list[float] = []
    left_out: dict[str, str] = {}
    for axis in axes or [name for name in AXES if known_samples(log, name)[0].size]:
        try:
            values, rate = axis_samples(log, axis, stretch)
        except LogError as problem:
            if axes is not None:
                raise
            left_out[axis] = str(problem)
            continue
        curve = allan_curve(values, rate, confidence=confidence)
        terms = noise_terms(curve)
        notes = (*moving, *_steps(values), *_vibration(values, rate), *_misfit(terms))
        told.append(AxisNoise(axis=axis, curve=curve, terms=terms, notes=notes))
        rates.append(rate)
    if not told:
        raise LogError("; ".join(left_out.values()) or f"{log.metadata.name}: imu has no axis")
    return StandstillNoise(
        log=log.metadata.name,
        stretch=stretch,
        rate_hz=float(np.median(rates)),
        axes=tuple(told),
        left_out=left_out,
    )


def _moving(seconds: float) -> tuple[str, ...]:
    """Return a note where a car moves in a stretch that somebody chose."""
    if seconds < MOVES:
        return ()
    return (
        f"the car moves for {seconds:.0f} s of the stretch: what it reads then is no noise of the "
        "sensor, and the terms are rough",
    )


def _steps(values: FloatArray) -> tuple[str, ...]:
    """Return a note where a signal's steps are coarser than its noise."""
    levels = np.unique(values)
    step = float(np.median(np.diff(levels)))
    if step <= float(values.std()):
        return ()
    return (
        f"reads {levels.size} values, {step:.3g} apart: its step is coarser than its noise, and "
        "noise within a step is not seen",
    )


def _vibration(values: FloatArray, rate: float) -> tuple[str, ...]:
    """Return a note where one frequency holds much of a signal's power, as an engine's does."""
    frequency, power = welch(values, fs=rate, nperseg=min(values.size, 2048))
    band = frequency >= LOWEST_LINE
    if band.sum() < 16:
        return ()
    frequency, power = frequency[band], power[band]
    at = int(np.argmax(power))
    around = slice(max(at - 2, 0), at + 3)
    line = power[around].sum() - 5.0 * float(np.median(power))
    share = line / power.sum()
    if share < VIBRATION:
        return ()
    return (
        f"a vibration at {frequency[at]:.3g} Hz holds {100.0 * share:.0f} % of the power above "
        f"{LOWEST_LINE:g} Hz, as an idling engine's does: the white noise is the sensor's and the "
        "car's",
    )


def _misfit(terms: NoiseTerms) -> tuple[str, ...]:
    """Return a note where a curve is not what its terms make of it."""
    if not terms.foreign:
        return ()
    return (
        f"at {terms.misfit_tau:.3g} s the Allan deviation is {terms.misfit:.2g} times what its "
        "terms make: something else shakes it or filters it, and the terms are rough",
    )
