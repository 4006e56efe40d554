"""Sensor grades: the figures of gyros, accelerometers, odometers and GNSS receivers, by name.

Figures are one standard deviation of a draw per drive unless said otherwise, in the units of
data sheets. Class L has the white noise and the limits of [Shen2010] Table 1 (read as three
standard deviations) and adds nonlinearity, g-sensitivity and temperature; T is a tactical unit
as in its Table 2.
"""

from dataclasses import dataclass, field

from navlearn.errors import ConfigError


@dataclass(frozen=True, kw_only=True)
class GyroGrade:
    """A gyro triad.

    Attributes:
        bias_deg_per_s: Turn-on bias.
        scale_factor_percent: Scale-factor error.
        even_percent: Error per |rate|: scale factors to the left and right differ.
        odd_percent: Error per rate·|rate| at 1 rad/s.
        cross_axis_percent: Share of each other axis' rate.
        g_sensitivity_deg_per_s_per_g: Error per specific force along x and along y.
        temperature_deg_per_s_per_k: Bias change per kelvin since the start.
        bias_instability_deg_per_h: Standard deviation of a Gauss–Markov bias.
        correlation_time: Of that bias, s.
        rate_random_walk_deg_per_h_per_sqrt_h: Growth of a random-walk bias.
        angle_random_walk_deg_per_sqrt_h: White noise.
        step_deg_per_s: Quantisation step; zero for none.
    """

    bias_deg_per_s: float = 0.0
    scale_factor_percent: float = 0.0
    even_percent: float = 0.0
    odd_percent: float = 0.0
    cross_axis_percent: float = 0.0
    g_sensitivity_deg_per_s_per_g: float = 0.0
    temperature_deg_per_s_per_k: float = 0.0
    bias_instability_deg_per_h: float = 0.0
    correlation_time: float = 300.0
    rate_random_walk_deg_per_h_per_sqrt_h: float = 0.0
    angle_random_walk_deg_per_sqrt_h: float = 0.0
    step_deg_per_s: float = 0.0


@dataclass(frozen=True, kw_only=True)
class AccelerometerGrade:
    """An accelerometer triad.

    Attributes:
        bias_mg: Turn-on bias.
        scale_factor_percent: Scale-factor error.
        quadratic_mg_per_g2: Error per square of the specific force.
        cross_axis_percent: Share of each other axis' specific force.
        temperature_mg_per_k: Bias change per kelvin since the start.
        bias_instability_mg: Standard deviation of a Gauss–Markov bias.
        correlation_time: Of that bias, s.
        random_walk_mg_per_sqrt_h: Growth of a random-walk bias.
        velocity_random_walk_m_per_s_per_sqrt_h: White noise.
        step_mg: Quantisation step; zero for none.
    """

    bias_mg: float = 0.0
    scale_factor_percent: float = 0.0
    quadratic_mg_per_g2: float = 0.0
    cross_axis_percent: float = 0.0
    temperature_mg_per_k: float = 0.0
    bias_instability_mg: float = 0.0
    correlation_time: float = 300.0
    random_walk_mg_per_sqrt_h: float = 0.0
    velocity_random_walk_m_per_s_per_sqrt_h: float = 0.0
    step_mg: float = 0.0


@dataclass(frozen=True, kw_only=True)
class OdometerGrade:
    """A speed source.

    Attributes:
        scale_factor_percent: Scale-factor error (wheel radius).
        noise: White noise of each sample, m/s; none at standstill.
        dead_speed_kmh: Below it the source reads zero.
        step_kmh: Quantisation step; zero for none.
        latency: How late samples are stamped, s.
    """

    scale_factor_percent: float = 0.0
    noise: float = 0.0
    dead_speed_kmh: float = 0.0
    step_kmh: float = 0.0
    latency: float = 0.0


@dataclass(frozen=True, kw_only=True)
class GnssGrade:
    """A GNSS receiver; heights are :attr:`vertical_factor` times as bad.

    Attributes:
        noise: White noise of east and north, m.
        correlated_noise: Standard deviation of a Gauss–Markov error of east and north, m.
        correlation_time: Of that error, s.
        vertical_factor: Height error over horizontal error.
        velocity_noise: White noise of each velocity component, m/s.
        spike_probability: Share of fixes that are outliers.
        spike: Standard deviation of an outlier's east and north offset, m.
        latency: How late fixes are stamped, s.
    """

    noise: float = 0.0
    correlated_noise: float = 0.0
    correlation_time: float = 60.0
    vertical_factor: float = 1.6
    velocity_noise: float = 0.0
    spike_probability: float = 0.0
    spike: float = 30.0
    latency: float = 0.0


@dataclass(frozen=True, kw_only=True)
class SensorGrade:
    """The sensors of one car.

    Attributes:
        name: Short name.
        summary: What it stands for, for the log's metadata.
        gyro: Gyro triad.
        accelerometer: Accelerometer triad.
        odometer: Speed source.
        gnss: Receiver.
        warming_k: How much the sensors warm up over a drive, K.
        warming_time: Time constant of the warming, s.
    """

    name: str
    summary: str
    gyro: GyroGrade = field(default_factory=GyroGrade)
    accelerometer: AccelerometerGrade = field(default_factory=AccelerometerGrade)
    odometer: OdometerGrade = field(default_factory=OdometerGrade)
    gnss: GnssGrade = field(default_factory=GnssGrade)
    warming_k: float = 0.0
    warming_time: float = 900.0


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
