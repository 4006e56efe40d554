"""RISS mechanization parallel in time: cumulative sums and fixed-point passes.

All but the vertical Earth and transport rates is an integral of known inputs; those two are small,
so the midpoint rule of :mod:`navlearn.mechanization.riss` is solved for all samples at once by
Picard iteration. Channels lie as (..., T) each: sums run along contiguous memory.
"""

import torch
from torch import Tensor

from navlearn import earth, wgs84
from navlearn.errors import ShapeError
from navlearn.mechanization.motion import RissMotion, over_time, riss_motion
from navlearn.mechanization.options import RissOptions
from navlearn.mechanization.riss_adjoint import integrate
from navlearn.states import NavState, RissSample, Trajectory


def riss_over_time(
    start: NavState,
    samples: RissSample,
    gyro_bias: Tensor | None = None,
    odometer_scale: Tensor | None = None,
    pitch_bias: Tensor | None = None,
    options: RissOptions | None = None,
) -> Trajectory:
    """Return the trajectory over records, all samples at once.

    Equals :class:`navlearn.mechanization.riss.RissMechanization` to 1e-6 m over an hour, and is
    differentiable in the start, the samples and the sensor errors.

    Args:
        start: State before the first interval, shape (...) each.
        samples: Samples, shape (..., T) each; intervals of dt = 0 move nothing.
        gyro_bias: Error of the yaw rate, rad/s, shape (...) or (..., T); None means zero.
        odometer_scale: Relative error of the odometer, measured = (1 + k) true, shape (...) or
            (..., T); None means zero.
        pitch_bias: Error of the pitch, rad, shape (...) or (..., T); None means zero.
        options: Choices; None means the defaults.

    Returns:
        Trajectory, shape (..., T) each.

    Raises:
        ShapeError: If the start does not have the samples' batch shape, or is not float64.
    """
    options = options or RissOptions()
    _check(start, samples)
    zero = samples.dt.new_zeros(())
    motion = riss_motion(
        samples,
        zero if gyro_bias is None else over_time(gyro_bias, samples.dt),
        zero if odometer_scale is None else over_time(odometer_scale, samples.dt),
        zero if pitch_bias is None else over_time(pitch_bias, samples.dt),
        options.three_d,
        options.compensates_tilt,
        options.hold_stationary,
    )
    earth_rate = wgs84.EARTH_RATE if options.earth_rate else 0.0
    if options.gradient == "tape":
        return integrate_on_tape(start, motion, earth_rate, options.passes)
    return integrate(start, motion, earth_rate, options.passes)


def integrate_on_tape(
    start: NavState, motion: RissMotion, earth_rate: float, passes: int
) -> Trajectory:
    """Integrate motion in plain operations, one chunk: the oracle of the adjoint form.

    Args:
        start: State before the first interval, shape (...) each.
        motion: Motion, shape (..., T) each.
        earth_rate: Rotation rate of the Earth, rad/s, or zero.
        passes: Fixed-point passes.

    Returns:
        Trajectory, shape (..., T) each.
    """
    lat_0, lon_0, height_0, azimuth_0 = (x.unsqueeze(-1) for x in start)
    way, climb = motion.v_h * motion.dt, motion.v_u * motion.dt
    turn_of_earth = earth_rate * motion.dt
    height = height_0 + torch.cumsum(climb, -1)
    mid_height = height - 0.5 * climb
    lat, d_lon = lat_0, torch.zeros_like(way)
    north, east = d_lon, d_lon
    d_lat, turn = d_lon, motion.turn
    for _ in range(passes + 1):
        if earth_rate != 0.0:
            turn = motion.turn + torch.sin(lat) * (turn_of_earth + d_lon)
        azimuth = azimuth_0 + _to_middle(turn)
        east, north = torch.sin(azimuth), torch.cos(azimuth)
        d_lat = way * north / (earth.meridian_radius(lat) + mid_height)
        lat = lat_0 + _to_middle(d_lat)
        d_lon = way * east / ((earth.prime_vertical_radius(lat) + mid_height) * torch.cos(lat))
    return Trajectory(
        lat_0 + torch.cumsum(d_lat, -1),
        lon_0 + torch.cumsum(d_lon, -1),
        height,
        azimuth_0 + torch.cumsum(turn, -1),
        motion.v_h * east,
        motion.v_h * north,
        motion.v_u,
    )


def _to_middle(increments: Tensor) -> Tensor:
    return torch.cumsum(increments, -1) - 0.5 * increments


def _check(start: NavState, samples: RissSample) -> None:
    batch = samples.dt.shape[:-1]
    for name, value in zip(start._fields, start, strict=True):
        if value.shape != batch:
            raise ShapeError(
                f"riss_over_time: start.{name} has shape {tuple(value.shape)}, samples have "
                f"{tuple(samples.dt.shape)}; expected {tuple(batch)}: one start per record"
            )
        if value.dtype != torch.float64:
            raise ShapeError(
                f"riss_over_time: start.{name} is {value.dtype}; geodetic angles need float64 "
                "(float32 rounds positions to half a metre): convert it with .double()"
            )
