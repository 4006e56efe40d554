"""What only a simulation knows of its yaw gyro, kept beside a log and never inside it.

Methods are handed a drive log; an oracle asks for this further table on demand, so that no
method can come upon it by accident.
"""

import hashlib
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np
import numpy.typing as npt
import pandas as pd

from navlearn.errors import LogError
from navlearn.logs.drive_log import DriveLog
from navlearn.logs.truth_file import read_truth, write_truth

Array = npt.NDArray[np.float64]

SENSOR_TRUTH: Final = "sensor_truth.csv.gz"
"""File in the folder of a log that navlearn simulated."""

COLUMNS: Final = ("t", "yaw_rate", "gyro_error", "gyro_drift")


@dataclass(frozen=True, kw_only=True)
class SensorTruth:
    """The parts of a yaw gyro's readings at its N stamps: the rest of a reading is white noise.

    Attributes:
        t: Stamps of the IMU, s, shape (N,).
        yaw_rate: What an error-free gyro reads, rad/s, shape (N,); where an error was put onto
            a real gyro, what that one read.
        gyro_error: Deterministic part of the error: turn-on bias, scale, nonlinearity, cross
            axis, g-sensitivity, temperature, rad/s, shape (N,).
        gyro_drift: Slow random part of the error: bias instability and random walk, rad/s,
            shape (N,).
    """

    t: Array
    yaw_rate: Array
    gyro_error: Array
    gyro_drift: Array

    def of(self, log: DriveLog) -> "SensorTruth":
        """Return the part at the IMU stamps of a log, which may be cut.

        Args:
            log: The drive that this was written with.

        Raises:
            LogError: The log has a stamp that is not here: it is another drive.
        """
        t = log.imu["t"].to_numpy(np.float64)
        place = np.minimum(np.searchsorted(self.t, t), self.t.size - 1)
        if not np.array_equal(self.t[place], t):
            row = int(np.argmax(self.t[place] != t))
            raise LogError(
                f"{log.metadata.name}: the truth of its gyro has no value at the IMU stamp "
                f"{t[row]:g} s; it belongs to another drive: write log and truth together again"
            )
        return SensorTruth(
            t=t,
            yaw_rate=self.yaw_rate[place],
            gyro_error=self.gyro_error[place],
            gyro_drift=self.gyro_drift[place],
        )

    def fingerprint(self) -> str:
        """Return a hash of the values."""
        digest = hashlib.sha256()
        for name in COLUMNS:
            digest.update(np.ascontiguousarray(getattr(self, name)).tobytes())
        return digest.hexdigest()


def save_sensor_truth(truth: SensorTruth, folder: Path) -> Path:
    """Write the truth of a gyro beside a log.

    Args:
        truth: The truth.
        folder: Folder of the log; a truth that is there is replaced.

    Returns:
        The file.
    """
    table = pd.DataFrame({name: getattr(truth, name) for name in COLUMNS})
    return write_truth(table, folder / SENSOR_TRUTH)


def load_sensor_truth(folder: Path) -> SensorTruth:
    """Read the truth of a gyro that lies beside a log.

    Args:
        folder: Folder of the log.

    Raises:
        LogNotFoundError: There is none: the drive is not a simulated one.
        LogError: The file cannot be used.
    """
    remedy = (
        "an oracle needs a simulated drive; make one with navlearn simulate, or leave the oracles "
        "out"
    )
    table = read_truth(folder / SENSOR_TRUTH, COLUMNS, remedy)
    return SensorTruth(**{name: table[name].to_numpy(np.float64) for name in COLUMNS})
