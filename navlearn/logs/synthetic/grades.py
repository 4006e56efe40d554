"""Sensor grades by name.

Class L has the white noise and the limits of [Shen2010] Table 1 (read as three
standard deviations) and adds nonlinearity, g-sensitivity and temperature; T is a tactical unit
as in its Table 2.
"""

from navlearn.errors import ConfigError
from navlearn.logs.synthetic.figures import (
    AccelerometerGrade,
    GnssGrade,
    GyroGrade,
    OdometerGrade,
    SensorGrade,
)

_CONSUMER_GNSS = GnssGrade(
    noise=0.6, correlated_noise=1.5, velocity_noise=0.08, spike_probability=0.002
)
_WHEEL_SPEED = OdometerGrade(scale_factor_percent=0.7, noise=0.03, step_kmh=0.05)
_MEMS_ACCELEROMETER = AccelerometerGrade(
    bias_mg=8.0,
    scale_factor_percent=0.3,
    quadratic_mg_per_g2=0.3,
    cross_axis_percent=0.3,
    temperature_mg_per_k=0.05,
    bias_instability_mg=0.1,
    random_walk_mg_per_sqrt_h=0.1,
    velocity_random_walk_m_per_s_per_sqrt_h=0.1,
    step_mg=0.25,
)
_LOW_COST_GYRO = GyroGrade(
    bias_deg_per_s=0.67,
    scale_factor_percent=0.33,
    even_percent=0.9,
    odd_percent=1.5,
    cross_axis_percent=0.5,
    g_sensitivity_deg_per_s_per_g=0.3,
    temperature_deg_per_s_per_k=0.01,
    bias_instability_deg_per_h=20.0,
    rate_random_walk_deg_per_h_per_sqrt_h=20.0,
    angle_random_walk_deg_per_sqrt_h=2.25,
    step_deg_per_s=0.02,
)

GRADES: dict[str, SensorGrade] = {
    grade.name: grade
    for grade in (
        SensorGrade(name="ideal", summary="sensors without error"),
        SensorGrade(
            name="tactical",
            summary="class T: fibre-optic or ring-laser gyro of tactical grade",
            gyro=GyroGrade(
                bias_deg_per_s=0.33 / 3600.0,
                scale_factor_percent=0.005,
                even_percent=0.002,
                cross_axis_percent=0.03,
                bias_instability_deg_per_h=0.3,
                rate_random_walk_deg_per_h_per_sqrt_h=0.3,
                angle_random_walk_deg_per_sqrt_h=0.1,
            ),
            accelerometer=AccelerometerGrade(
                bias_mg=0.33,
                scale_factor_percent=0.01,
                cross_axis_percent=0.03,
                bias_instability_mg=0.03,
                velocity_random_walk_m_per_s_per_sqrt_h=0.03,
            ),
            odometer=_WHEEL_SPEED,
            gnss=_CONSUMER_GNSS,
            warming_k=5.0,
        ),
        SensorGrade(
            name="mems_l",
            summary="class L: low-cost MEMS, noisy, with nonlinearity, g-sensitivity and drift",
            gyro=_LOW_COST_GYRO,
            accelerometer=AccelerometerGrade(
                bias_mg=10.0,
                scale_factor_percent=0.33,
                quadratic_mg_per_g2=0.5,
                cross_axis_percent=0.5,
                temperature_mg_per_k=0.1,
                bias_instability_mg=0.3,
                random_walk_mg_per_sqrt_h=0.2,
                velocity_random_walk_m_per_s_per_sqrt_h=0.15,
                step_mg=0.5,
            ),
            odometer=_WHEEL_SPEED,
            gnss=_CONSUMER_GNSS,
            warming_k=15.0,
        ),
        SensorGrade(
            name="mems_m",
            summary="class M: present-day automotive MEMS",
            gyro=GyroGrade(
                bias_deg_per_s=0.2,
                scale_factor_percent=0.5,
                even_percent=0.2,
                odd_percent=0.3,
                cross_axis_percent=0.3,
                g_sensitivity_deg_per_s_per_g=0.05,
                temperature_deg_per_s_per_k=0.003,
                bias_instability_deg_per_h=8.0,
                rate_random_walk_deg_per_h_per_sqrt_h=8.0,
                angle_random_walk_deg_per_sqrt_h=0.6,
                step_deg_per_s=0.005,
            ),
            accelerometer=_MEMS_ACCELEROMETER,
            odometer=_WHEEL_SPEED,
            gnss=_CONSUMER_GNSS,
            warming_k=12.0,
        ),
        SensorGrade(
            name="mems_x",
            summary="class X: quiet MEMS, badly calibrated",
            gyro=GyroGrade(
                bias_deg_per_s=0.3,
                scale_factor_percent=3.0,
                even_percent=0.9,
                odd_percent=1.5,
                cross_axis_percent=1.0,
                g_sensitivity_deg_per_s_per_g=0.1,
                temperature_deg_per_s_per_k=0.003,
                bias_instability_deg_per_h=5.0,
                rate_random_walk_deg_per_h_per_sqrt_h=5.0,
                angle_random_walk_deg_per_sqrt_h=0.2,
                step_deg_per_s=0.005,
            ),
            accelerometer=_MEMS_ACCELEROMETER,
            odometer=_WHEEL_SPEED,
            gnss=_CONSUMER_GNSS,
            warming_k=12.0,
        ),
        SensorGrade(
            name="low_cost_obd",
            summary="class L gyro with OBD-II speed and a late receiver: an add-on logger",
            gyro=_LOW_COST_GYRO,
            accelerometer=_MEMS_ACCELEROMETER,
            odometer=OdometerGrade(
                scale_factor_percent=1.0, dead_speed_kmh=1.0, step_kmh=1.0, latency=0.3
            ),
            gnss=GnssGrade(
                noise=1.0,
                correlated_noise=2.5,
                velocity_noise=0.12,
                spike_probability=0.005,
                latency=0.2,
            ),
            warming_k=15.0,
        ),
    )
}
"""Grades by name."""


def find_grade(grade: str | SensorGrade) -> SensorGrade:
    """Return a grade by its name, or the grade itself.

    Raises:
        ConfigError: No grade has this name.
    """
    if isinstance(grade, SensorGrade):
        return grade
    if grade not in GRADES:
        raise ConfigError(f"grade: found {grade!r}, expected one of {', '.join(GRADES)}")
    return GRADES[grade]
