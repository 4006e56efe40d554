"""Laying the way that a gyro and an odometer tell onto positions, to see where a car is and heads.

Gauss-Newton with weights after Huber ([Huber1964]) over where the way ends, its azimuth there, the
gyro's bias and the odometer's scale. Positions err together over seconds: the covariance is that of
the estimator under exponentially correlated errors, too, not under white ones alone.
"""

import math
from typing import NamedTuple

import torch
from torch import Tensor


class Way(NamedTuple):
    """Intervals of driving that end where the fit is wanted, shape (T,) each.

    Attributes:
        dt: Lengths, s.
        turn_rate: Rate of azimuth as the gyro tells it, Earth rate taken off, rad/s.
        speed: Odometer speed, m/s.
    """

    dt: Tensor
    turn_rate: Tensor
    speed: Tensor


class Positions(NamedTuple):
    """Positions along the way, shape (M,) each.

    Attributes:
        time: When, s from the begin of the way.
        east: East of any origin, m.
        north: North of it, m.
        sigma: Standard deviation of each component, m.
    """

    time: Tensor
    east: Tensor
    north: Tensor
    sigma: Tensor


class Prior(NamedTuple):
    """What is known of the sensors before.

    Attributes:
        gyro_bias: Error of the yaw rate, rad/s, anticlockwise positive.
        gyro_bias_sigma: Its standard deviation, rad/s.
        scale_sigma: Standard deviation of the odometer's relative error.
    """

    gyro_bias: float
    gyro_bias_sigma: float
    scale_sigma: float


class TrackFit(NamedTuple):
    """Where the way ends.

    Attributes:
        east: East of the origin, m, scalar; north, azimuth and gyro bias alike.
        north: North of it, m.
        azimuth: Azimuth, rad.
        gyro_bias: Error of the yaw rate, rad/s.
        covariance: Covariance of east, north, azimuth, gyro bias, odometer scale, shape (5, 5).
    """

    east: Tensor
    north: Tensor
    azimuth: Tensor
    gyro_bias: Tensor
    covariance: Tensor


def fit_track(
    way: Way, seen: Positions, prior: Prior, *, huber: float, correlation_time: float
) -> TrackFit:
    """Return the end of a way that was laid onto positions.

    Args:
        way: The way.
        seen: Positions along it, at least three.
        prior: What is known of the sensors.
        huber: Deviations from which a position counts less and less.
        correlation_time: Time after which errors of positions have forgotten each other, s.
    """
    unknown = _first_guess(way, seen, prior)
    known = torch.tensor([0.0, 0.0, 0.0, prior.gyro_bias, 0.0], dtype=torch.float64)
    spread = torch.tensor([prior.gyro_bias_sigma, prior.scale_sigma], dtype=torch.float64)
    information = torch.diag(torch.cat((torch.zeros(3, dtype=torch.float64), spread**-2)))
    for _ in range(30):
        residual, design = _residual(way, seen, unknown)
        weight = _weight(residual, seen.sigma, huber)
        weighted = design * weight.unsqueeze(-1)
        normal = torch.einsum("aki,akj->ij", design, weighted) + information
        pull = torch.einsum("aki,ak->i", weighted, residual) + information @ (known - unknown)
        step = torch.linalg.solve(normal, pull)
        unknown = unknown + step
        if float(torch.abs(step[:2]).max()) < 1e-4 and abs(float(step[2])) < 1e-7:
            break
    residual, design = _residual(way, seen, unknown)
    weight = _weight(residual, seen.sigma, huber)
    covariance = _covariance(seen, residual, design, weight, information, correlation_time)
    return TrackFit(unknown[0], unknown[1], unknown[2], unknown[3], covariance)


def way_back(way: Way, time: Tensor, gyro_bias: Tensor) -> tuple[Tensor, Tensor]:
    """Return where the car was, seen from the end of its way, and how a gyro bias moves that.

    Args:
        way: The way.
        time: Moments, s from its begin, shape (M,).
        gyro_bias: Error of the yaw rate, rad/s, scalar.

    Returns:
        To the right and ahead of the car at the end, m, shape (2, M); the same per rad/s.
    """
    end = torch.cumsum(way.dt, 0)
    middle = end - 0.5 * way.dt - end[-1]
    rate = way.turn_rate + gyro_bias
    azimuth = torch.cumsum(rate * way.dt, 0)
    azimuth = azimuth - 0.5 * rate * way.dt - azimuth[-1]
    east, north = way.speed * torch.sin(azimuth), way.speed * torch.cos(azimuth)
    steps = torch.stack((east, north, middle * north, -middle * east)) * way.dt
    nodes = torch.cat((steps.new_zeros(4, 1), torch.cumsum(steps, 1)), 1)
    left = torch.searchsorted(end, time).clamp(max=len(end) - 1)
    share = (time - (end - way.dt)[left]) / way.dt[left].clamp_min(1e-12)
    back = nodes[:, left] + share * steps[:, left] - nodes[:, -1:]
    return back[:2], back[2:]


def _residual(way: Way, seen: Positions, unknown: Tensor) -> tuple[Tensor, Tensor]:
    """Return positions less those of the fit, shape (2, M), and the fit's derivatives (2, M, 5)."""
    east, north, azimuth, bias, scale = unknown.unbind()
    back, by_bias = way_back(way, seen.time, bias)
    s, c = torch.sin(azimuth), torch.cos(azimuth)

    def turned(track: Tensor) -> Tensor:
        return torch.stack((c * track[0] + s * track[1], c * track[1] - s * track[0]))

    # an odometer that reads too much makes the way too long
    track = turned(back) * (1.0 - scale)
    place = torch.stack((east, north)).unsqueeze(-1) + track
    one, zero = torch.ones_like(seen.time), torch.zeros_like(seen.time)
    unit_east, unit_north = torch.stack((one, zero)), torch.stack((zero, one))
    by_azimuth = torch.stack((track[1], -track[0]))
    columns = (unit_east, unit_north, by_azimuth, turned(by_bias) * (1.0 - scale), -turned(back))
    return torch.stack((seen.east, seen.north)) - place, torch.stack(columns, -1)


def _weight(residual: Tensor, sigma: Tensor, huber: float) -> Tensor:
    size = torch.linalg.vector_norm(residual, dim=0) / sigma
    weight: Tensor = huber / size.clamp_min(huber) / sigma**2
    return weight.expand(2, -1)


def _first_guess(way: Way, seen: Positions, prior: Prior) -> Tensor:
    """Return the best of many azimuths, the end at the median of what each position says."""
    back, _ = way_back(way, seen.time, torch.tensor(prior.gyro_bias, dtype=torch.float64))
    azimuth = torch.arange(72, dtype=torch.float64).unsqueeze(-1) * (math.pi / 36.0)
    s, c = torch.sin(azimuth), torch.cos(azimuth)
    east = seen.east - (c * back[0] + s * back[1])
    north = seen.north - (c * back[1] - s * back[0])
    middle_e, middle_n = east.median(-1, keepdim=True)[0], north.median(-1, keepdim=True)[0]
    cost = (torch.hypot(east - middle_e, north - middle_n) / seen.sigma).sum(-1)
    best = int(cost.argmin())
    sensors = azimuth.new_tensor([prior.gyro_bias, 0.0])
    return torch.cat((middle_e[best], middle_n[best], azimuth[best], sensors))


def _covariance(
    seen: Positions,
    residual: Tensor,
    design: Tensor,
    weight: Tensor,
    information: Tensor,
    correlation_time: float,
) -> Tensor:
    """Return the covariance of the weighted estimator under correlated or under white errors.

    Whichever leaves the azimuth less certain: over a short way correlated errors hardly turn it.
    Where residuals are larger than such errors would leave, these are taken to be as much larger.
    """
    inverse = torch.linalg.inv(torch.einsum("aki,ak,akj->ij", design, weight, design) + information)
    gain = torch.einsum("ij,akj,ak->iak", inverse, design, weight)
    apart = torch.abs(seen.time.unsqueeze(-1) - seen.time)
    share = weight[0] * seen.sigma**2
    found = share @ (residual / seen.sigma).square().sum(0)
    both = []
    for together in (torch.exp(-apart / correlation_time), (apart == 0.0).to(apart)):
        noise = seen.sigma.unsqueeze(-1) * together * seen.sigma
        moved = torch.einsum("iak,kl->ial", gain, noise)
        spread = torch.einsum("iak,jak->ij", moved, gain)
        left = (
            2.0 * seen.sigma**2
            - 2.0 * torch.einsum("aki,iak->k", design, moved)
            + torch.einsum("aki,ij,akj->k", design, spread, design)
        )
        larger = max(float(found / (share @ (left / seen.sigma**2))), 1.0)
        both.append(larger * spread + inverse @ information @ inverse)
    chosen: Tensor = max(both, key=lambda covariance: float(covariance[2, 2]))
    return chosen
