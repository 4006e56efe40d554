"""Mathematics of one chunk of the parallel RISS: Picard iteration, and its adjoint.

The midpoint rule of :mod:`navlearn.mechanization.riss` for all samples of a chunk at once. With
an increment d_k per interval, the state in the middle of interval j is x_0 + Σ_{k<j} d_k + d_j/2.
Backwards, an increment therefore collects the cotangents of all later middles and half its own.
Arrays lie as (records, samples), and all run without autograd.
"""

from typing import NamedTuple

import torch
from torch import Tensor

from navlearn import wgs84
from navlearn.mechanization.motion import RissMotion

TOLERANCE = 3e-8
"""Error of position at which a chunk's iteration may stop, m."""


class _Radii(NamedTuple):
    """Sine and cosine of latitude, and 1/(R_M + h), 1/((R_N + h) cos φ)."""

    sin_lat: Tensor
    cos_lat: Tensor
    per_lat: Tensor
    per_lon: Tensor


def _radii(sin_lat: Tensor, height: Tensor) -> _Radii:
    # cos φ > 0 between the poles, so a root replaces a cosine
    square = sin_lat * sin_lat
    cos_lat = torch.sqrt(1.0 - square)
    root = torch.rsqrt(1.0 - wgs84.ECCENTRICITY_SQUARED * square)
    r_n = wgs84.SEMI_MAJOR_AXIS * root
    r_m = (1.0 - wgs84.ECCENTRICITY_SQUARED) * r_n * root * root
    return _Radii(sin_lat, cos_lat, 1.0 / (r_m + height), 1.0 / ((r_n + height) * cos_lat))


def _to_middle(increments: Tensor, start: Tensor) -> Tensor:
    return torch.cumsum(increments, -1).sub_(increments, alpha=0.5).add_(start)


class Moved(NamedTuple):
    """Increments of one chunk, its directions and sin φ at the middles of intervals."""

    lat: Tensor
    lon: Tensor
    height: Tensor
    azimuth: Tensor
    east: Tensor
    north: Tensor
    sin_lat: Tensor


def move_chunk(
    state: list[Tensor], motion: RissMotion, earth_rate: float, most_passes: int
) -> tuple[Moved, int]:
    """Move the car through all intervals of a chunk.

    Args:
        state: Latitude, longitude, height and azimuth at the chunk's start, shape (B, 1) each.
        motion: Motion, shape (B, n) each.
        earth_rate: Rotation rate of the Earth, rad/s, or zero.
        most_passes: Passes after which to stop even if the chunk has not converged.

    Returns:
        What moved, shape (B, n) each, and the number of passes taken.
    """
    dt, turn, v_h, v_u = motion
    way, climb, turn_of_earth = v_h * dt, v_u * dt, earth_rate * dt
    height = _to_middle(climb, state[2])
    azimuth = without_grid = _to_middle(turn, state[3])
    lat, radii = state[0], _radii(torch.sin(state[0]), state[2])
    grid = radii.sin_lat * turn_of_earth
    turns = earth_rate != 0.0
    scale = float(way.abs().sum(-1).amax()) if turns else wgs84.SEMI_MAJOR_AXIS
    before, passes = 0.0, 0
    while True:
        last = azimuth if turns else lat
        azimuth = _to_middle(grid, without_grid)
        east, north = torch.sin(azimuth), torch.cos(azimuth)
        d_lat = (way * north).mul_(radii.per_lat)
        lat = _to_middle(d_lat, state[0])
        radii = _radii(torch.sin(lat), height)
        d_lon = (way * east).mul_(radii.per_lon)
        if turns:
            grid = (turn_of_earth + d_lon).mul_(radii.sin_lat)
        passes += 1
        change = scale * float(((azimuth if turns else lat) - last).abs_().amax())
        # change²/before is what the next pass would change, were the convergence only linear
        if passes >= most_passes or change * change <= TOLERANCE * before:
            break
        before = change
    return Moved(d_lat, d_lon, climb, grid.add_(turn), east, north, radii.sin_lat), passes


class _Slopes(NamedTuple):
    """How increments of one chunk change with the state at the middle, rad per rad or metre."""

    lat_by_azimuth: Tensor
    lon_by_azimuth: Tensor
    lat_by_lat: Tensor
    lon_by_lat: Tensor
    lat_by_height: Tensor
    lon_by_height: Tensor
    grid_by_lat: Tensor


def _slopes(
    radii: _Radii, way: Tensor, height: Tensor, east: Tensor, north: Tensor, turn_of_earth: Tensor
) -> _Slopes:
    sin_lat, cos_lat, per_lat, per_lon = radii
    along_lat, along_lon = way * per_lat, way * per_lon
    d_lat, d_lon = along_lat * north, along_lon * east
    square = wgs84.ECCENTRICITY_SQUARED * sin_lat
    oblate = square * cos_lat / (1.0 - square * sin_lat)
    return _Slopes(
        -along_lat * east,
        along_lon * north,
        -3.0 * d_lat * oblate * (1.0 - height * per_lat),
        d_lon * (sin_lat / cos_lat - oblate * (1.0 - height * cos_lat * per_lon)),
        -d_lat * per_lat,
        -d_lon * cos_lat * per_lon,
        cos_lat * (turn_of_earth + d_lon),
    )


def _from_end(cotangent: Tensor, later: Tensor) -> Tensor:
    sums = torch.cumsum(cotangent, -1)
    return (later + sums[:, -1:]) - sums + cotangent


def _through_middle(cotangent: Tensor, total: Tensor) -> Tensor:
    # an increment moves all later middles, and its own by half
    sums = torch.cumsum(cotangent, -1)
    return (total + sums[:, -1:]).sub_(sums).add_(cotangent, alpha=0.5)


def adjoint_chunk(
    g: list[Tensor], later: list[Tensor], saved: list[Tensor], earth_rate: float, passes: int
) -> tuple[Tensor, Tensor, Tensor, Tensor]:
    """Return the cotangents of dt, turn, v_h, v_u; ``later`` moves on to the chunk's start."""
    dt, v_h, v_u, height, east, north, sin_lat = saved
    mid_height = torch.addcmul(height, v_u, dt, value=-0.5)
    radii = _radii(sin_lat, mid_height)
    slopes = _slopes(radii, v_h * dt, mid_height, east, north, earth_rate * dt)
    from_lat, on_lon, from_height, from_azimuth = (_from_end(g[k], later[k]) for k in range(4))
    from_direction = (g[4] * north).addcmul_(g[5], east, value=-1.0)

    coupling = 0.0 if earth_rate == 0.0 else 1.0
    on_lat, on_turn = from_lat, from_azimuth
    for _ in range(passes):
        on_way = torch.addcmul(on_lon, radii.sin_lat, on_turn, value=coupling)
        at_azimuth = torch.addcmul(from_direction, on_way, slopes.lon_by_azimuth)
        at_azimuth.addcmul_(on_lat, slopes.lat_by_azimuth)
        on_turn = _through_middle(at_azimuth, from_azimuth)
        on_way = torch.addcmul(on_lon, radii.sin_lat, on_turn, value=coupling)
        at_lat = (on_way * slopes.lon_by_lat).addcmul_(on_lat, slopes.lat_by_lat)
        at_lat.addcmul_(on_turn, slopes.grid_by_lat, value=coupling)
        on_lat = _through_middle(at_lat, from_lat)
    at_height = (on_way * slopes.lon_by_height).addcmul_(on_lat, slopes.lat_by_height)
    on_height = _through_middle(at_height, from_height)

    on_v_h = on_way * east * radii.per_lon + on_lat * north * radii.per_lat
    on_dt = on_v_h * v_h + on_height * v_u + earth_rate * sin_lat * on_turn
    later[0] = from_lat[:, :1] + at_lat.sum(-1, keepdim=True)
    later[1] = on_lon[:, :1]
    later[2] = from_height[:, :1] + at_height.sum(-1, keepdim=True)
    later[3] = from_azimuth[:, :1] + at_azimuth.sum(-1, keepdim=True)
    return on_dt, on_turn, on_v_h * dt, on_height * dt
