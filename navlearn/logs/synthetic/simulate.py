"""One call: a motion, a sensor grade and a seed become a drive log with its truth."""

import math
from dataclasses import dataclass, replace

import numpy as np
import pandas as pd

from navlearn.errors import ConfigError
from navlearn.logs.drive_log import DriveLog, LogMetadata
from navlearn.logs.synthetic.aiding import fix_table, odometer_table, reference_table
from navlearn.logs.synthetic.draws import Array
from navlearn.logs.synthetic.figures import SensorGrade
from navlearn.logs.synthetic.grades import find_grade
from navlearn.logs.synthetic.inertial_errors import (
    accelerometer_errors,
    gyro_errors,
    warming,
)
from navlearn.logs.synthetic.inverse import (
    Truth,
    grid_stride,
    ideal_inertial,
    integrate,
    interval_means,
    truth_at,
)
from navlearn.logs.synthetic.log_parts import (
    START_TEMPERATURE,
    describe,
    imu_table,
    thermometer,
)
from navlearn.logs.synthetic.motion import Motion
from navlearn.logs.synthetic.profile import draw_motion
from navlearn.logs.synthetic.ranged_log import with_ranges
from navlearn.logs.synthetic.ranges import SimulatedRanges, simulated_ranges
from navlearn.logs.synthetic.satellite_options import SatelliteOptions, find_satellites
from navlearn.logs.synthetic.simulated_drive import SimulatedDrive

ORIGIN = (math.radians(44.23), math.radians(-76.49), 60.0)
"""Where drives start unless said otherwise: latitude (rad), longitude (rad), height (m)."""


@dataclass(frozen=True, kw_only=True)
class _Scene:
    """What one drive holds before any sensor reads it."""

    motion: Motion
    grid: Truth
    end: float
    odometer_rate_hz: float
    fix_rate_hz: float
    lever_arm: tuple[float, float, float]
    reference: pd.DataFrame
    seed: int

    def log(
        self, measured: SensorGrade, imu: pd.DataFrame, stamped: SensorGrade, about: LogMetadata
    ) -> DriveLog:
        """Return the log of one set of sensors, at the stamps that ``stamped`` would have."""
        at_odometer = stamps(self.end, self.odometer_rate_hz, stamped.odometer.latency)
        at_fix = stamps(self.end, self.fix_rate_hz, stamped.gnss.latency)
        speed = self.motion.at(at_odometer - measured.odometer.latency).speed
        where = truth_at(self.grid, self.motion, at_fix - measured.gnss.latency)
        return DriveLog(
            imu=imu,
            odometer=odometer_table(at_odometer, speed, grade=measured.odometer, seed=self.seed),
            fixes=fix_table(
                at_fix, where, grade=measured.gnss, lever_arm=self.lever_arm, seed=self.seed
            ),
            reference=self.reference.copy(),
            metadata=about,
        )

    def ranges(
        self, measured: SensorGrade, stamped: SensorGrade, options: SatelliteOptions
    ) -> SimulatedRanges:
        """Return the ranges that a receiver takes in together with its fixes."""
        at = stamps(self.end, self.fix_rate_hz, stamped.gnss.latency)
        return simulated_ranges(
            at,
            truth_at(self.grid, self.motion, at - measured.gnss.latency),
            options=options,
            lever_arm=self.lever_arm,
            seed=self.seed,
        )


def stamps(end: float, rate_hz: float, latency: float) -> Array:
    """Return uniform stamps up to ``end``, none of which was valid before t = 0, s."""
    return np.arange(math.ceil(latency * rate_hz - 1e-9), math.floor(end * rate_hz + 1e-9) + 1) / (
        rate_hz
    )


def simulate_drive(
    *,
    profile: str | Motion = "mixed",
    grade: str | SensorGrade = "mems_m",
    duration: float = 1800.0,
    seed: int = 0,
    imu_rate_hz: float = 100.0,
    odometer_rate_hz: float = 10.0,
    fix_rate_hz: float = 1.0,
    reference_rate_hz: float = 10.0,
    origin: tuple[float, float, float] | None = None,
    lever_arm: tuple[float, float, float] = (0.0, 0.0, 0.0),
    standstill: float = 30.0,
    satellites: str | SatelliteOptions | None = None,
    name: str | None = None,
) -> SimulatedDrive:
    """Return a seeded drive: log, error-free log, and the gyro's deterministic error.

    IMU samples are means over the interval that ends at their stamp; odometer and fixes are
    instantaneous and stamped late by their grade's latency.

    Args:
        profile: Name of a driving profile, or a motion (of a recorded trajectory, say).
        grade: Name of a sensor grade, or a grade.
        duration: Length, s; a motion that is shorter ends the drive.
        seed: Seed of every draw, not negative.
        imu_rate_hz: Rate of the inertial samples, Hz.
        odometer_rate_hz: Rate of the odometer, Hz.
        fix_rate_hz: Rate of the fixes, Hz.
        reference_rate_hz: Rate of the truth in the log's reference, Hz.
        origin: Start: latitude (rad), longitude (rad), height (m); None takes the motion's own,
            or :data:`ORIGIN`.
        lever_arm: Antenna from the IMU, right, forward, up, m.
        standstill: How long the car stands before it starts, s; for named profiles.
        satellites: Satellites, streets and receiver that the log gets ranges from at the rate of
            its fixes: options or the name of a preset; None for a log without ranges. All else
            but the fixes is drawn as without them.
        name: Name of the log; made of profile, grade and seed where None.

    Raises:
        ConfigError: A name is not known, or a figure makes no sense.
    """
    figures = find_grade(grade)
    options = None if satellites is None else find_satellites(satellites)
    _check(
        seed,
        imu_rate_hz=imu_rate_hz,
        odometer_rate_hz=odometer_rate_hz,
        fix_rate_hz=fix_rate_hz,
        reference_rate_hz=reference_rate_hz,
    )
    kind = "motion" if isinstance(profile, Motion) else profile
    motion = (
        profile
        if isinstance(profile, Motion)
        else draw_motion(profile, duration=duration, seed=seed, standstill=standstill)
    )
    start = _origin(origin, motion)
    stride, dt = grid_stride(imu_rate_hz), 1.0 / imu_rate_hz
    count = math.floor(min(duration, motion.duration) * imu_rate_hz + 1e-9)
    if count < 2:
        raise ConfigError(f"duration: found {duration} s, expected at least two IMU samples")
    # Whole fractions of a grid step: the last stamp may not overshoot the motion's end.
    grid = integrate(motion, start, np.arange(count * stride + 1) / (imu_rate_hz * stride))
    at_reference = stamps(count * dt, reference_rate_hz, 0.0)
    scene = _Scene(
        motion=motion,
        grid=grid,
        end=float(grid.t[-1]),
        odometer_rate_hz=odometer_rate_hz,
        fix_rate_hz=fix_rate_hz,
        lever_arm=lever_arm,
        reference=reference_table(truth_at(grid, motion, at_reference)),
        seed=seed,
    )
    t = grid.t[stride::stride]
    rate, force = (interval_means(a, stride) for a in ideal_inertial(grid))
    warm = warming(t, figures.warming_k, figures.warming_time)
    gyros = gyro_errors(rate, force, warm, dt, grade=figures.gyro, seed=seed)
    accels = accelerometer_errors(force, warm, dt, grade=figures.accelerometer, seed=seed)
    read_rate = [e.apply(rate[:, i]) for i, e in enumerate(gyros)]
    read_force = [e.apply(force[:, i]) for i, e in enumerate(accels)]
    title = name or f"{kind}_{figures.name}_{seed}"
    source = f"navlearn simulator: {motion.description or kind}"
    about = describe(title, source, figures, kind, seed, lever_arm)
    ideal = find_grade("ideal")
    drive = SimulatedDrive(
        log=scene.log(
            figures,
            imu_table(t, read_rate, read_force, thermometer(warm, seed)),
            figures,
            about,
        ),
        ideal=scene.log(
            ideal,
            imu_table(t, list(rate.T), list(force.T), START_TEMPERATURE + warm),
            figures,
            describe(f"{title}_ideal", source, ideal, kind, seed, lever_arm),
        ),
        gyro_errors=gyros[2],
        motion=motion,
        grade=figures,
        seed=seed,
    )
    return drive if options is None else _with_ranges(drive, scene, options)


def _with_ranges(drive: SimulatedDrive, scene: _Scene, options: SatelliteOptions) -> SimulatedDrive:
    made = prompt = scene.ranges(drive.grade, drive.grade, options)
    if drive.grade.gnss.latency > 0.0:
        prompt = scene.ranges(find_grade("ideal"), drive.grade, options)
    return replace(
        drive,
        log=with_ranges(drive.log, made, options=options),
        ideal=with_ranges(
            drive.ideal, prompt.without_errors(), options=replace(options, fixes="drawn")
        ),
        range_truth=made.truth,
    )


def _origin(asked: tuple[float, float, float] | None, motion: Motion) -> tuple[float, float, float]:
    start = asked or motion.origin or ORIGIN
    if not abs(start[0]) < math.radians(89.0):
        raise ConfigError(
            f"origin: found latitude {start[0]}, expected radians within 89° of the equator; "
            "convert degrees with math.radians"
        )
    return start


def _check(seed: int, **rates: float) -> None:
    if seed < 0:
        raise ConfigError(f"seed: found {seed}, expected zero or more")
    for name, value in rates.items():
        if not 0.0 < value <= 1000.0:
            raise ConfigError(f"{name}: found {value}, expected a rate above 0 and up to 1000 Hz")
