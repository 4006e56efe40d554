"""RISS mechanization sample by sample: streaming, scriptable, the oracle of the parallel form.

[Iqbal2020] §V and [Shen2010] Eqs. (1)–(3), by the midpoint rule: latitude, height and azimuth
in the right-hand sides are those at the middle of the interval. The vertical Earth and transport
rates are written sin φ (ω_e + λ̇), which equals ω_e sin φ + v_e tan φ/(R_N + h). Azimuth is not
wrapped; latitudes within 0.1° of a pole are outside the domain.
"""

from typing import NamedTuple

import torch
from torch import Tensor, nn

from navlearn import earth, wgs84
from navlearn.mechanization.motion import RissMotion, over_time, riss_motion
from navlearn.mechanization.options import RissOptions
from navlearn.states import NavState, RissSample, Trajectory


class MovedState(NamedTuple):
    """A state and the mean velocity that led to it, shape (...) each.

    Attributes:
        state: State at the end of the interval.
        v_e: Mean velocity to the east, m/s.
        v_n: Mean velocity to the north, m/s.
        v_u: Mean velocity up, m/s.
    """

    state: NavState
    v_e: Tensor
    v_n: Tensor
    v_u: Tensor


def move(state: NavState, motion: RissMotion, earth_rate: float = wgs84.EARTH_RATE) -> MovedState:
    """Move the car through one interval.

    [Shen2010] Eqs. (1)–(3) by the midpoint rule: one predictor for the middle of the interval,
    then a first-order turn of the direction by what the predictor left out (its square is
    below 1e-11 for intervals up to a second).

    Args:
        state: State at the start of the interval, shape (...) each.
        motion: Motion in the interval, shape (...) each.
        earth_rate: Rotation rate of the Earth, rad/s; zero when the yaw rate is relative to
            the ground, which drops the transport rate too.

    Returns:
        State at the end of the interval and mean velocity.
    """
    way = motion.v_h * motion.dt
    climb = motion.v_u * motion.dt
    height = state.height + 0.5 * climb
    turn_of_earth = earth_rate * motion.dt
    first_guess = torch.sin(state.lat) * turn_of_earth
    azimuth = state.azimuth + 0.5 * (motion.turn + first_guess)
    east, north = torch.sin(azimuth), torch.cos(azimuth)

    lat = state.lat + 0.5 * way * north / (earth.meridian_radius(state.lat) + height)
    sin_lat = torch.sin(lat)
    per_lon = 1.0 / ((earth.prime_vertical_radius(lat) + height) * torch.cos(lat))
    if earth_rate == 0.0:
        grid_turn = torch.zeros_like(way)
    else:
        left_out = 0.5 * (sin_lat * (turn_of_earth + way * east * per_lon) - first_guess)
        east, north = east + north * left_out, north - east * left_out
        grid_turn = sin_lat * (turn_of_earth + way * east * per_lon)

    moved = NavState(
        state.lat + way * north / (earth.meridian_radius(lat) + height),
        state.lon + way * east * per_lon,
        state.height + climb,
        state.azimuth + motion.turn + grid_turn,
    )
    return MovedState(moved, motion.v_h * east, motion.v_h * north, motion.v_u)


def riss_step(
    state: NavState,
    sample: RissSample,
    gyro_bias: Tensor,
    odometer_scale: Tensor,
    pitch_bias: Tensor,
    three_d: bool = True,
    tilt_compensation: bool = True,
    hold_stationary: bool = False,
    earth_rate: float = wgs84.EARTH_RATE,
) -> NavState:
    """Return the state after one sample.

    [Iqbal2020] §V; :func:`riss_motion` then :func:`move`.

    Args:
        state: State at the start of the interval, shape (...) each.
        sample: Sample of the interval, shape (...) each.
        gyro_bias: Error of the yaw rate, rad/s, shape (...).
        odometer_scale: Relative error of the odometer, measured = (1 + k) true, shape (...).
        pitch_bias: Error of the pitch, rad, shape (...); unused in 2D.
        three_d: Whether pitch and roll are used and height moves.
        tilt_compensation: Whether the yaw rate is divided by cos p cos r (3D only).
        hold_stationary: Whether nothing moves where ``stationary`` is 1.
        earth_rate: Rotation rate of the Earth, rad/s, or zero for a ground-relative yaw rate.

    Returns:
        State at the end of the interval.
    """
    motion = riss_motion(
        sample,
        gyro_bias,
        odometer_scale,
        pitch_bias,
        three_d,
        tilt_compensation,
        hold_stationary,
    )
    return move(state, motion, earth_rate).state


def move_through(start: NavState, motion: RissMotion, earth_rate: float) -> Trajectory:
    """Move the car through intervals, one after another.

    Args:
        start: State before the first interval, shape (...) each.
        motion: Motion, shape (..., T) each.
        earth_rate: Rotation rate of the Earth, rad/s, or zero; see :func:`move`.

    Returns:
        Trajectory, shape (..., T) each.
    """
    # unbind: indexing inside the loop would make the backward pass quadratic in T
    dt, turn = torch.unbind(motion.dt, -1), torch.unbind(motion.turn, -1)
    v_h, v_u = torch.unbind(motion.v_h, -1), torch.unbind(motion.v_u, -1)
    lat: list[Tensor] = []
    lon: list[Tensor] = []
    height: list[Tensor] = []
    azimuth: list[Tensor] = []
    v_e: list[Tensor] = []
    v_n: list[Tensor] = []
    state = start
    for k in range(len(dt)):
        moved = move(state, RissMotion(dt[k], turn[k], v_h[k], v_u[k]), earth_rate)
        state = moved.state
        lat.append(state.lat)
        lon.append(state.lon)
        height.append(state.height)
        azimuth.append(state.azimuth)
        v_e.append(moved.v_e)
        v_n.append(moved.v_n)
    return Trajectory(
        torch.stack(lat, -1),
        torch.stack(lon, -1),
        torch.stack(height, -1),
        torch.stack(azimuth, -1),
        torch.stack(v_e, -1),
        torch.stack(v_n, -1),
        motion.v_u,
    )


class RissMechanization(nn.Module):
    """RISS mechanization that streams: ``step`` per sample, ``forward`` over a record."""

    three_d: bool
    tilt_compensation: bool
    hold_stationary: bool
    earth_rate: float

    def __init__(self, options: RissOptions | None = None) -> None:
        """Keep the options.

        Args:
            options: Choices; None means the defaults.
        """
        super().__init__()
        options = options or RissOptions()
        self.three_d = options.three_d
        self.tilt_compensation = options.compensates_tilt
        self.hold_stationary = options.hold_stationary
        self.earth_rate = wgs84.EARTH_RATE if options.earth_rate else 0.0

    @torch.jit.export
    def step(
        self,
        state: NavState,
        sample: RissSample,
        gyro_bias: Tensor,
        odometer_scale: Tensor,
        pitch_bias: Tensor,
    ) -> NavState:
        """Return the state after one sample; see :func:`riss_step`.

        Args:
            state: State at the start of the interval, shape (...) each.
            sample: Sample of the interval, shape (...) each.
            gyro_bias: Error of the yaw rate, rad/s, shape (...).
            odometer_scale: Relative error of the odometer, shape (...).
            pitch_bias: Error of the pitch, rad, shape (...).

        Returns:
            State at the end of the interval.
        """
        return riss_step(
            state,
            sample,
            gyro_bias,
            odometer_scale,
            pitch_bias,
            self.three_d,
            self.tilt_compensation,
            self.hold_stationary,
            self.earth_rate,
        )

    def forward(
        self,
        start: NavState,
        samples: RissSample,
        gyro_bias: Tensor,
        odometer_scale: Tensor,
        pitch_bias: Tensor,
    ) -> Trajectory:
        """Return the trajectory over a record, one step after another.

        Args:
            start: State before the first interval, shape (...) each.
            samples: Samples, shape (..., T) each.
            gyro_bias: Error of the yaw rate, rad/s, shape (...) or (..., T).
            odometer_scale: Relative error of the odometer, shape (...) or (..., T).
            pitch_bias: Error of the pitch, rad, shape (...) or (..., T).

        Returns:
            Trajectory, shape (..., T) each.
        """
        motion = riss_motion(
            samples,
            over_time(gyro_bias, samples.dt),
            over_time(odometer_scale, samples.dt),
            over_time(pitch_bias, samples.dt),
            self.three_d,
            self.tilt_compensation,
            self.hold_stationary,
        )
        return move_through(start, motion, self.earth_rate)
