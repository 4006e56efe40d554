"""What a sensor grade consists of: the figures of gyros, accelerometers, odometers, receivers.

Figures are one standard deviation of a draw per drive unless said otherwise, in the units of
data sheets.
"""

from dataclasses import dataclass, field


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
