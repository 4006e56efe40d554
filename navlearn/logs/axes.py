"""Turning published sensor axes into the body frame RFU.

Two steps: which sensor axis points right, forward and up (a signed permutation), then how far
the sensor is tilted in the car (levelling).
"""

import math
from typing import Final

import numpy as np
import pandas as pd
import torch

from navlearn.attitude import matrix_from_angles
from navlearn.errors import ConfigError
from navlearn.logs.interval_means import FloatArray

TRIADS: Final = (("gyro_x", "gyro_y", "gyro_z"), ("accel_x", "accel_y", "accel_z"))

_LETTERS: Final = {
    "R": (1.0, 0.0, 0.0),
    "L": (-1.0, 0.0, 0.0),
    "F": (0.0, 1.0, 0.0),
    "B": (0.0, -1.0, 0.0),
    "U": (0.0, 0.0, 1.0),
    "D": (0.0, 0.0, -1.0),
}


def matrix_from_letters(letters: str) -> FloatArray:
    """Return C_bs, which turns sensor vectors into the body frame RFU.

    Args:
        letters: Where the sensor's x, y and z point: three of R, L, F, B, U, D, such as ``FLU``.

    Raises:
        ConfigError: The letters do not name a right-handed triad.
    """
    if len(letters) != 3 or any(letter not in _LETTERS for letter in letters):
        raise ConfigError(
            f"axes: {letters!r} does not tell where x, y and z point; give three of R, L, F, B, "
            "U, D, such as FLU"
        )
    return _right_handed(np.array([_LETTERS[letter] for letter in letters]).T, letters)


def matrix_from_directions(right: str, forward: str, up: str) -> FloatArray:
    """Return C_bs, which turns sensor vectors into the body frame RFU.

    Args:
        right: Sensor axis that points right, such as ``-y``.
        forward: Sensor axis that points forward.
        up: Sensor axis that points up.

    Raises:
        ConfigError: An axis is not x, y or z with a sign, or they are no right-handed triad.
    """
    rows = []
    for direction, axis in (("right", right), ("forward", forward), ("up", up)):
        letter = axis.strip().lstrip("+-").strip()
        if letter not in ("x", "y", "z"):
            raise ConfigError(f"axes.{direction}: found {axis!r}; give x, y or z with a sign")
        sign = -1.0 if axis.strip().startswith("-") else 1.0
        rows.append([sign * (letter == name) for name in ("x", "y", "z")])
    return _right_handed(np.array(rows), f"right: {right}, forward: {forward}, up: {up}")


def levelling_matrix(*, pitch: float, roll: float, yaw: float = 0.0) -> FloatArray:
    """Return the rotation from a tilted sensor into the level car.

    Args:
        pitch: Pitch of the sensor in the car, rad, nose up.
        roll: Roll of the sensor in the car, rad, right side down.
        yaw: How far the sensor's forward axis lies clockwise of the car's, seen from above, rad.
    """
    angles = (torch.tensor(angle, dtype=torch.float64) for angle in (yaw, pitch, roll))
    matrix: FloatArray = matrix_from_angles(*angles).numpy()
    return matrix


def turned(imu: pd.DataFrame, matrix: FloatArray) -> pd.DataFrame:
    """Return an IMU table with gyro and accelerometer resolved in other axes.

    A triad of which the log has not all three axes is turned where no missing axis is needed.

    Args:
        imu: Table with ``gyro_*`` and ``accel_*`` in sensor axes.
        matrix: Rotation from sensor to body, shape (3, 3).

    Returns:
        The table in body axes; components that need a missing axis are left out.
    """
    rest = [name for name in imu if not any(name in triad for triad in TRIADS)]
    columns = {str(name): imu[name].to_numpy(np.float64) for name in rest}
    for triad in TRIADS:
        for row, target in zip(matrix, triad, strict=True):
            terms = [(c, name) for c, name in zip(row, triad, strict=True) if abs(c) > 1e-12]
            if all(name in imu for _, name in terms):
                columns[target] = _weighted_sum(imu, terms)
    return pd.DataFrame(columns)


def _weighted_sum(imu: pd.DataFrame, terms: list[tuple[float, str]]) -> FloatArray:
    total = np.zeros(len(imu))
    for weight, name in terms:
        total = total + weight * imu[name].to_numpy(np.float64)
    return total


def _right_handed(matrix: FloatArray, found: str) -> FloatArray:
    if not math.isclose(float(np.linalg.det(matrix)), 1.0):
        raise ConfigError(
            f"axes: {found} is no right-handed triad (a mirror image, or an axis used twice); "
            "check the signs"
        )
    return matrix
