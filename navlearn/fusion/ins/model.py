"""One full-IMU filter's choices made ready, and its linear dynamics."""

from dataclasses import dataclass

from torch import Tensor

from navlearn.filters.consistency import chi_square_quantile
from navlearn.fusion.gate_options import GateOptions
from navlearn.fusion.ins.dahmane2022 import dahmane2022_dynamics
from navlearn.fusion.ins.error_dynamics import Motion, phi_angle_dynamics, with_sensors
from navlearn.fusion.ins.imu_errors import ImuErrors
from navlearn.fusion.ins.layout import InsLayout, ins_layout
from navlearn.fusion.ins.linear_steps import density_of
from navlearn.fusion.ins.measurements import InsKind, ins_rows
from navlearn.fusion.ins.noise import InsNoise, walks, white_noise
from navlearn.fusion.ins.options import InsEkfOptions
from navlearn.fusion.ins.sample_step import decayed
from navlearn.fusion.measurements import Rows


@dataclass(frozen=True)
class InsFilterModel:
    """A filter's choices made ready.

    Attributes:
        options: The choices.
        layout: Order of the error states.
        rows: Rows of each kind of measurement.
        limits: Largest NIS that the gate lets pass, per kind taken.
    """

    options: InsEkfOptions
    layout: InsLayout
    rows: Rows
    limits: tuple[float, ...]

    @property
    def gate(self) -> GateOptions:
        """When a measurement is refused."""
        return self.options.gate

    @property
    def anchor(self) -> int | None:
        """GNSS position, where it is used: it alone tells that the filter has run away."""
        return InsKind.POSITION if self.options.position else None

    @property
    def company(self) -> tuple[int, ...]:
        """GNSS velocity: what the car's own sensors say beside it could only be had by a tilt."""
        return (InsKind.VELOCITY,)

    @property
    def closed(self) -> bool:
        """Whether estimated errors are fed back."""
        return self.options.feedback == "closed"


def ins_filter_model(options: InsEkfOptions) -> InsFilterModel:
    """Return a filter's choices made ready.

    Args:
        options: The choices.

    Returns:
        Model.
    """
    rows = ins_rows(options)
    limits = tuple(chi_square_quantile(options.gate.probability, n) for n in rows.count)
    return InsFilterModel(options, ins_layout(options), rows, limits)


def dynamics(model: InsFilterModel, motion: Motion, errors: ImuErrors) -> Tensor:
    """Return F of the chosen error model.

    Args:
        model: The filter.
        motion: Motion, batch shape (...).
        errors: Sensor parameters, batch shape (...).

    Returns:
        F, 1/s, shape (..., n, n).
    """
    simple = model.options.model == "dahmane2022"
    core = dahmane2022_dynamics(motion) if simple else phi_angle_dynamics(motion)
    has, tau = model.layout.sensor_states, model.options.correlation_time
    return with_sensors(core, motion, errors, has, tau)


def advanced_sensor(model: InsFilterModel, sensor: Tensor, dt: Tensor) -> Tensor:
    """Return sensor parameters after an interval: Gauss–Markov biases decay, the others stay.

    Args:
        model: The filter.
        sensor: Sensor parameters, shape (..., m).
        dt: Length of the interval, s, shape (...).

    Returns:
        Sensor parameters, shape (..., m).
    """
    return decayed(sensor, model.layout.sensor_states, model.options.correlation_time, dt)


def diffusion(layout: InsLayout, omega_ib_b: Tensor, noise: InsNoise) -> Tensor:
    """Return the diagonal of the spectral density of the noise that drives the errors.

    Args:
        layout: Order of the error states.
        omega_ib_b: Angular rate, rad/s, shape (..., 3).
        noise: Noise densities.

    Returns:
        Density per error state, its unit squared per second, shape (..., n).
    """
    return density_of(omega_ib_b, white_noise(noise), walks(layout, noise))
