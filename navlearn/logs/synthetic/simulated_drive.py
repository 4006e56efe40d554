"""What a simulation gives: a drive, and what only a simulation knows of it."""

from dataclasses import dataclass

import numpy as np

from navlearn.logs.drive_log import DriveLog
from navlearn.logs.range_truth import RangeTruth
from navlearn.logs.sensor_truth import SensorTruth
from navlearn.logs.synthetic.draws import Array
from navlearn.logs.synthetic.figures import SensorGrade
from navlearn.logs.synthetic.inertial_errors import AxisErrors
from navlearn.logs.synthetic.motion import Motion


@dataclass(frozen=True, kw_only=True)
class SimulatedDrive:
    """A simulated drive with what only a simulation knows; N IMU samples.

    Attributes:
        log: What the sensors read; its reference is the truth.
        ideal: The same drive with error-free sensors at the same stamps, without latency.
        gyro_errors: Parts of the z gyro's error and their coefficients.
        motion: The drive itself; None where the truth came from forces and rates.
        grade: The sensors' figures.
        seed: Seed of every draw.
        range_truth: True errors of the log's ranges and its receiver's clock; None where it has
            no ranges.
    """

    log: DriveLog
    ideal: DriveLog
    gyro_errors: AxisErrors
    motion: Motion | None
    grade: SensorGrade
    seed: int
    range_truth: RangeTruth | None = None

    @property
    def gyro_deterministic_error(self) -> Array:
        """Deterministic part of the z gyro's error, turn-on bias included, rad/s, shape (N,)."""
        return self.gyro_errors.deterministic_total()

    @property
    def sensor_truth(self) -> SensorTruth:
        """What an oracle may know of the z gyro."""
        return SensorTruth(
            t=self.log.imu["t"].to_numpy(np.float64),
            yaw_rate=self.ideal.imu["gyro_z"].to_numpy(np.float64),
            gyro_error=self.gyro_errors.deterministic_total(),
            gyro_drift=self.gyro_errors.drift(),
        )
