"""What sensor parameters do to samples: the regressors of gyro and odometer errors.

A gyro measures ω + Σ g_j θ_j with regressors g of what it measured; the odometer measures
(1 + κ) v(t − τ). Removing them gives the motion that the filter integrates.
"""

import math
from typing import NamedTuple

import torch
from torch import Tensor

from navlearn.fusion.options import EkfOptions
from navlearn.mechanization.motion import RissMotion, riss_motion
from navlearn.states import RissSample


class SensorErrors(NamedTuple):
    """Which sensor parameters a filter has; plain values, so that scripted code can hold it.

    Attributes:
        gyro_terms: Gyro terms in order.
        speed_terms: Odometer terms in order.
        pitch_bias: Whether the last parameter is a pitch bias.
        velocity_states: Whether the parameters are those of the Shen models instead.
        correlation_time: Of the gyro bias about its value at alignment, s; 0 means infinite.
        three_d: Whether pitch and roll are used.
        tilt_compensation: Whether the yaw rate is divided by cos p cos r.
        hold_stationary: Whether nothing moves where ``stationary`` is 1.
    """

    gyro_terms: list[str]
    speed_terms: list[str]
    pitch_bias: bool
    velocity_states: bool
    correlation_time: float
    three_d: bool
    tilt_compensation: bool
    hold_stationary: bool


def sensor_errors(options: EkfOptions) -> SensorErrors:
    """Return the sensor parameters of a filter.

    Args:
        options: Choices of the filter.

    Returns:
        Plain values.
    """
    return SensorErrors(
        list(options.gyro_states),
        list(options.speed_states),
        options.has_pitch_state,
        options.has_velocity_states,
        0.0 if math.isinf(options.correlation_time) else options.correlation_time,
        options.mechanization.three_d,
        options.mechanization.compensates_tilt,
        options.zero_speed or options.mechanization.hold_stationary,
    )


def gyro_regressor(term: str, sample: RissSample) -> Tensor:
    """Return the regressor g of a gyro error term.

    Args:
        term: ``bias``, ``scale``, ``abs_scale``, ``quadratic``, ``f_x`` or ``f_y``.
        sample: Samples, shape (...) each.

    Returns:
        1, ω, |ω|, ω|ω|, f_x or f_y, shape (...).
    """
    rate = sample.yaw_rate
    if term == "scale":
        return rate
    if term == "abs_scale":
        return torch.abs(rate)
    if term == "quadratic":
        return rate * torch.abs(rate)
    if term == "f_x":
        return sample.f_x
    if term == "f_y":
        return sample.f_y
    return torch.ones_like(rate)


def speed_regressor(term: str, sample: RissSample, acceleration: Tensor) -> Tensor:
    """Return by how much an odometer error other than scale is to be added per its parameter.

    Args:
        term: ``delay`` or ``offset``.
        sample: Samples, shape (...) each.
        acceleration: Forward acceleration by the odometer, m/s², shape (...).

    Returns:
        Acceleration, or 1 where the odometer says that the car moves, shape (...).
    """
    if term == "delay":
        return acceleration
    return torch.where(sample.speed > 0.1, 1.0, 0.0).to(sample.speed.dtype)


def decay_over(errors: SensorErrors, elapsed: Tensor) -> Tensor:
    """Return what is left of a Gauss–Markov deviation after some time.

    Args:
        errors: Sensor parameters of the filter.
        elapsed: Time, s, shape (...).

    Returns:
        exp(−t/τ), or ones for a random walk, shape (...).
    """
    if errors.correlation_time == 0.0:
        return torch.ones_like(elapsed)
    return torch.exp(-elapsed / errors.correlation_time)


def decaying(errors: SensorErrors) -> list[bool]:
    """Return which sensor parameters return to their value at alignment.

    Args:
        errors: Sensor parameters of the filter.

    Returns:
        One flag per sensor parameter.
    """
    if errors.velocity_states:
        return [True, True]
    flags = [term == "bias" for term in errors.gyro_terms]
    flags += [False for _ in errors.speed_terms]
    if errors.pitch_bias:
        flags.append(False)
    return flags


def advanced(errors: SensorErrors, sensor: Tensor, anchor: Tensor, duration: Tensor) -> Tensor:
    """Return sensor parameters after some time without measurement.

    Args:
        errors: Sensor parameters of the filter.
        sensor: Parameters, shape (..., m).
        anchor: Their values at alignment, shape (..., m).
        duration: Time, s, shape (...).

    Returns:
        Parameters, shape (..., m).
    """
    if errors.correlation_time == 0.0:
        return sensor
    returning = torch.tensor(decaying(errors), device=sensor.device)
    left = decay_over(errors, duration).unsqueeze(-1)
    return torch.where(returning, anchor + (sensor - anchor) * left, sensor)


def corrected_motion(
    errors: SensorErrors,
    sample: RissSample,
    acceleration: Tensor,
    sensor: Tensor,
    anchor: Tensor,
    decay: Tensor,
) -> RissMotion:
    """Return the motion of samples once the estimated sensor errors are removed.

    Args:
        errors: Sensor parameters of the filter.
        sample: Samples, shape (...) each, or (..., n) with parameters (..., 1, m).
        acceleration: Forward acceleration by the odometer, m/s², shape of the samples.
        sensor: Parameters, broadcastable to (*samples, m).
        anchor: Their values at alignment, the same shape.
        decay: What is left of a Gauss–Markov deviation, shape of the samples.

    Returns:
        Motion, shape of the samples.
    """
    # scalars broadcast: a full channel of zeros would cost as much as one that counts
    gyro = scale = pitch = sample.dt.new_zeros(())
    raw = sample
    if errors.velocity_states:
        bias = sensor[..., 1]
        gyro = anchor[..., 1] + (bias - anchor[..., 1]) * decay
    else:
        j = 0
        for term in errors.gyro_terms:
            value = sensor[..., j]
            if term == "bias":
                if errors.correlation_time > 0.0:
                    value = anchor[..., j] + (value - anchor[..., j]) * decay
                gyro = gyro + value
            else:
                gyro = gyro + gyro_regressor(term, sample) * value
            j += 1
        for term in errors.speed_terms:
            if term == "scale":
                scale = sensor[..., j]
            else:
                added = sensor[..., j] * speed_regressor(term, raw, acceleration)
                sample = sample._replace(speed=sample.speed + added)
            j += 1
        if errors.pitch_bias:
            pitch = sensor[..., j]
    return riss_motion(
        sample,
        gyro,
        scale,
        pitch,
        errors.three_d,
        errors.tilt_compensation,
        errors.hold_stationary,
    )


def odometer_acceleration(
    dt: Tensor, speed: Tensor, at: Tensor | None = None, span: float = 0.2
) -> Tensor:
    """Return forward acceleration by differencing the odometer over the last moments.

    Causal: the difference of two means of ``span`` each, so a stamped step is not a spike.

    Args:
        dt: Lengths of the intervals, s, shape (B, T).
        speed: Odometer speed, m/s, shape (B, T).
        at: Samples at whose end it is wanted, int64, shape (B, K); None means all.
        span: Length of each mean, s.

    Returns:
        Acceleration, m/s², shape (B, K) or (B, T); zero until two spans have passed.
    """
    length = dt.shape[-1]
    typical = float(dt[dt > 0].median()) if bool((dt > 0).any()) else 1.0
    lag = max(1, round(span / typical))
    way = torch.nn.functional.pad(torch.cumsum(speed * dt, -1), (1, 0))
    time = torch.nn.functional.pad(torch.cumsum(dt, -1), (1, 0))
    if at is not None:
        early = at + 1 < 2 * lag
        cuts = [(at + 1 - j * lag).clamp(min=0) for j in range(3)]
        ways, times = ([torch.gather(x, -1, cut) for cut in cuts] for x in (way, time))
        return torch.where(early, 0.0, _second_difference(ways, times))
    if length <= 2 * lag:
        return torch.zeros_like(speed)
    ways, times = ([x[..., 2 * lag :], x[..., lag:-lag], x[..., : -2 * lag]] for x in (way, time))
    late = _second_difference(ways, times)
    return torch.nn.functional.pad(late, (length - late.shape[-1], 0))


def _second_difference(way: list[Tensor], time: list[Tensor]) -> Tensor:
    mean = [(way[j] - way[j + 1]) / (time[j] - time[j + 1]).clamp(min=1e-9) for j in range(2)]
    gap = 0.5 * (time[0] - time[2])
    change = torch.where(gap > 0, mean[0] - mean[1], 0.0)
    return change / gap.clamp(min=1e-9)
