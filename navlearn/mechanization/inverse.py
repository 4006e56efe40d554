"""Inverse RISS: the error-free samples that would drive a given trajectory.

The midpoint rule of :mod:`navlearn.mechanization.riss` solved for its inputs: mechanizing what
comes out returns the trajectory.
"""

import torch
from torch import Tensor

from navlearn import earth, wgs84
from navlearn.errors import ShapeError
from navlearn.mechanization.motion import chord_over_arc
from navlearn.mechanization.options import RissOptions
from navlearn.states import NavState, RissSample, Trajectory


def inverse_riss(
    start: NavState,
    trajectory: Trajectory,
    dt: Tensor,
    roll: Tensor | None = None,
    options: RissOptions | None = None,
) -> RissSample:
    """Return the samples that lead from a start along a trajectory.

    [Shen2010] Eqs. (1)–(3) by the midpoint rule, solved for yaw rate, speed and pitch. What moved
    across the azimuth (a car that slips) is lost: speed is the way along it.

    Args:
        start: State before the first interval, shape (...) each.
        trajectory: States at the ends of intervals, shape (..., T) each; its velocities and, in
            2D, its height are not looked at.
        dt: Length of the intervals, s, shape (..., T); zero gives a sample of zeros.
        roll: Roll, rad, right side down, shape (..., T), which a trajectory does not tell; None
            means zero.
        options: Choices; None means the defaults.

    Returns:
        Samples, shape (..., T) each; specific force is zero, ``stationary`` is 1 where neither
        position nor azimuth changed.

    Raises:
        ShapeError: If dt has another shape than the trajectory.
    """
    options = options or RissOptions()
    if dt.shape != trajectory.lat.shape:
        raise ShapeError(
            f"inverse_riss: dt has shape {tuple(dt.shape)}, the trajectory "
            f"{tuple(trajectory.lat.shape)}; expected the same"
        )
    d_lat, lat = _steps(start.lat, trajectory.lat)
    d_lon, _ = _steps(start.lon, trajectory.lon)
    climb, height = _steps(start.height, trajectory.height)
    d_azimuth, azimuth = _steps(start.azimuth, trajectory.azimuth)
    if not options.three_d:
        climb, height = torch.zeros_like(climb), start.height.unsqueeze(-1)
    north = d_lat * (earth.meridian_radius(lat) + height)
    east = d_lon * (earth.prime_vertical_radius(lat) + height) * torch.cos(lat)
    earth_rate = wgs84.EARTH_RATE if options.earth_rate else 0.0
    grid = torch.sin(lat) * (earth_rate * dt + d_lon) if options.earth_rate else 0.0
    turn = d_azimuth - grid

    roll = torch.zeros_like(dt) if roll is None or not options.three_d else roll
    level_way = (east * torch.sin(azimuth) + north * torch.cos(azimuth)) / chord_over_arc(turn)
    pitch = torch.atan(_ratio(climb, level_way))
    way = torch.copysign(torch.hypot(level_way, climb), level_way)
    if options.compensates_tilt:
        turn = turn * torch.cos(pitch) * torch.cos(roll)
    stands = (way == 0.0) & (d_azimuth == 0.0)
    zero = torch.zeros_like(dt)
    return RissSample(
        dt, _ratio(-turn, dt), _ratio(way, dt), pitch, roll, zero, zero, stands.to(dt.dtype)
    )


def _steps(start: Tensor, ends: Tensor) -> tuple[Tensor, Tensor]:
    """Return increments and values at the middle of each interval."""
    begins = torch.cat((start.unsqueeze(-1), ends[..., :-1]), -1)
    return ends - begins, 0.5 * (begins + ends)


def _ratio(above: Tensor, below: Tensor) -> Tensor:
    """Return above/below, zero where below is zero."""
    zero = below == 0.0
    return torch.where(zero, 0.0, above / torch.where(zero, 1.0, below))
