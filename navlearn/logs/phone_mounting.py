"""How a phone stands in a car: up from gravity, forward from what the car's motion does to it.

The mean specific force points up: that levels the phone. How it is turned about the vertical is
told by the horizontal accelerations: gains of speed act forward, turns to the left. Both are
complex numbers in the horizontal plane, and one complex factor lays the car's acceleration on the
measured one; its angle is the phone's. Fixes are used, so an experiment that withholds fixes
should state the mounting in its descriptor and leave nothing to be found.
"""

import math
from dataclasses import dataclass
from typing import Final

import numpy as np
import pandas as pd
import torch

from navlearn.attitude import angles_from_matrix
from navlearn.logs.axes import levelling_matrix
from navlearn.logs.interval_means import FloatArray

SLOWEST: Final = 3.0
"""Slower than this a course says little, m/s."""

_SPAN: Final = 4.0
_LAGS: Final = np.arange(-1.5, 1.51, 0.1)
_LEAST_WINDOWS: Final = 30
_LEAST_COHERENCE: Final = 0.3
_PARTS: Final = 3
_MOST_APART: Final = math.radians(15.0)


@dataclass(frozen=True, kw_only=True)
class PhoneMounting:
    """How a phone stands in a car.

    Attributes:
        matrix: C_bs, which turns the phone's vectors into the car's, shape (3, 3). Where the yaw
            is unknown its first two rows are level, and no more.
        yaw_std: Standard deviation of the angle about the vertical, rad; None where unknown.
        turn_sign: −1 where turns of the fixes say that what is called up is down, else 1.
    """

    matrix: FloatArray
    yaw_std: float | None
    turn_sign: int

    def in_words(self) -> dict[str, object]:
        """Return axes and angles as a descriptor would state them."""
        up, forward = (int(np.argmax(np.abs(self.matrix[row]))) for row in (2, 1))
        if forward == up:
            forward = int(np.argsort(np.abs(self.matrix[1]))[1])
        rows = np.zeros((3, 3))
        for row, axis in ((2, up), (1, forward)):
            rows[row, axis] = math.copysign(1.0, self.matrix[row, axis])
        rows[0] = np.cross(rows[1], rows[2])
        names = {
            name: ("-" if row.sum() < 0.0 else "") + "xyz"[int(np.argmax(np.abs(row)))]
            for name, row in zip(("right", "forward", "up"), rows, strict=True)
        }
        turned = angles_from_matrix(torch.from_numpy(self.matrix @ rows.T))
        yaw, pitch, roll = (round(math.degrees(float(angle)), 2) for angle in turned)
        words: dict[str, object] = {"axes": names, "pitch_deg": pitch, "roll_deg": roll}
        if self.yaw_std is None:
            return {**words, "yaw_deg": None}
        return {**words, "yaw_deg": yaw, "yaw_std_deg": round(math.degrees(self.yaw_std), 2)}


def find_mounting(imu: pd.DataFrame, fixes: pd.DataFrame) -> PhoneMounting:
    """Return how a phone stands in a car.

    Args:
        imu: ``t`` (end of each sample's interval), ``gyro_*`` and ``accel_*`` (with gravity) in
            the phone's axes, all finite.
        fixes: ``t``, and ``v_e`` and ``v_n`` where known.

    Returns:
        The mounting. Its yaw is unknown where there is too little motion, where the accelerations
        do not follow it, or where the parts of the drive disagree: the phone was moved.
    """
    force = imu[["accel_x", "accel_y", "accel_z"]].to_numpy(np.float64)
    rate = imu[["gyro_x", "gyro_y", "gyro_z"]].to_numpy(np.float64)
    middle = np.median(force, axis=0)
    size = float(np.linalg.norm(middle))
    up = middle / size if size > 0.0 else np.array([0.0, 0.0, 1.0])
    moving = fixes.reindex(columns=["t", "v_e", "v_n"]).dropna()
    t_v = moving["t"].to_numpy(np.float64)
    v = moving["v_e"].to_numpy(np.float64) + 1j * moving["v_n"].to_numpy(np.float64)
    t = imu["t"].to_numpy(np.float64)
    turned = _turns(t, rate @ up, t_v, v)
    sign = -1 if turned < -0.5 else 1
    up = sign * up
    level = _level_rows(up)
    found = _yaw(t, sign * (force - middle) @ level.T, rate @ up, t_v, v)
    yaw, std = (0.0, None) if found is None else found
    # The phone's forward lies ``yaw`` clockwise of the car's: turn its vectors that much.
    matrix = levelling_matrix(yaw=yaw, pitch=0.0, roll=0.0) @ np.vstack((level, up))
    return PhoneMounting(matrix=matrix, yaw_std=std, turn_sign=sign)


def _level_rows(up: FloatArray) -> FloatArray:
    # Forward at first guess: into the screen of a phone that stands, or its top when it lies.
    guess = np.array([0.0, 0.0, -1.0]) if abs(up[2]) < 0.7 else np.array([0.0, 1.0, 0.0])
    forward = guess - (guess @ up) * up
    forward /= np.linalg.norm(forward)
    return np.stack((np.cross(forward, up), forward))


def _integral(t: FloatArray, values: FloatArray, at: FloatArray) -> FloatArray:
    steps = values[1:] * np.diff(t)[(...,) + (None,) * (values.ndim - 1)]
    total = np.concatenate((np.zeros_like(values[:1]), np.cumsum(steps, axis=0)))
    if total.ndim == 1:
        return np.interp(at, t, total)
    return np.stack([np.interp(at, t, column) for column in total.T], axis=-1)


def _windows(t: FloatArray, t_v: FloatArray, v: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return first and last fix of every span of steady motion within the inertial samples."""
    if t_v.size < 2:
        return np.zeros(0, dtype=np.int64), np.zeros(0, dtype=np.int64)
    first = np.arange(t_v.size)
    last = np.searchsorted(t_v, t_v + _SPAN - 1e-6)
    slow = np.concatenate(([0], np.cumsum(np.abs(v) < SLOWEST)))
    room = float(np.abs(_LAGS).max())
    kept = last < t_v.size
    first, last = first[kept], last[kept]
    kept = (slow[last + 1] == slow[first]) & (t_v[last] - t_v[first] < 1.5 * _SPAN)
    kept &= (t_v[first] > t[0] + room) & (t_v[last] < t[-1] - room)
    return first[kept], last[kept]


def _turns(t: FloatArray, rate: FloatArray, t_v: FloatArray, v: np.ndarray) -> float:
    """Return the correlation of turns about up with those of the fixes, zero where few."""
    first, last = _windows(t, t_v, v)
    if first.size < _LEAST_WINDOWS:
        return 0.0
    seen = np.angle(v[last] / v[first])
    felt = _integral(t, rate, t_v)
    felt = felt[last] - felt[first]
    if min(np.std(seen), np.std(felt)) < 1e-6:
        return 0.0
    return float(np.corrcoef(seen, felt)[0, 1])


def _yaw(
    t: FloatArray, level: FloatArray, rate: FloatArray, t_v: FloatArray, v: np.ndarray
) -> tuple[float, float] | None:
    first, last = _windows(t, t_v, v)
    if first.size < _LEAST_WINDOWS:
        return None
    speed = np.abs(v)
    coherence, factor, parts = -np.inf, 0j, np.zeros(0, dtype=np.complex128)
    for lag in _LAGS:
        # Complex with forward real and left imaginary: right is minus the imaginary part.
        felt = _integral(t, level, t_v + lag) @ np.array([-1j, 1.0])
        angle = _integral(t, rate, t_v + lag)
        left = np.concatenate(([0.0], np.cumsum(0.5 * (speed[1:] + speed[:-1]) * np.diff(angle))))
        done = speed + 1j * left
        y, x = felt[last] - felt[first], done[last] - done[first]
        found, share = _factor(x, y)
        if share > coherence:
            pairs = zip(_split(x), _split(y), strict=True)
            coherence, factor = share, found
            parts = np.array([_factor(a, b)[0] for a, b in pairs])
    if coherence < _LEAST_COHERENCE or factor == 0.0:
        return None
    apart = np.angle(parts / factor)
    if float(np.abs(apart).max()) > _MOST_APART:
        return None
    std = max(float(np.std(apart)) / math.sqrt(_PARTS - 1.0), math.radians(0.2))
    # A factor turned to the left says that the phone's forward lies to the right of the car's.
    return float(np.angle(factor)), std


def _split(x: np.ndarray) -> list[np.ndarray]:
    return np.array_split(x, _PARTS)


def _factor(x: np.ndarray, y: np.ndarray) -> tuple[complex, float]:
    x, y = x - x.mean(), y - y.mean()
    power = float(np.sum(np.abs(x) ** 2))
    total = float(np.sum(np.abs(y) ** 2))
    if power == 0.0 or total == 0.0:
        return 0.0, 0.0
    factor = complex(np.vdot(x, y) / power)
    return factor, 1.0 - float(np.sum(np.abs(y - factor * x) ** 2)) / total
