"""Where the fast form starts: what each reception tells by itself, and straight lines between.

Single-point positions and range-rate velocities are good to metres wherever four satellites are
received; where fewer are, passes find the way. A guess needs no gradient, and nothing in the result
depends on it.
"""

from typing import Any

import torch
from torch import Tensor

from navlearn.filters.tight_belief import TightBelief, map_tree
from navlearn.fusion.tight.clock import BIAS, DRIFT
from navlearn.fusion.tight.model import TightModel
from navlearn.fusion.tight.passes import VehiclePasses
from navlearn.fusion.tight.timeline import Reception
from navlearn.gnss.range_rate_velocity import RangeRateVelocity, range_rate_velocity
from navlearn.gnss.single_point import SinglePoint, single_point
from navlearn.gnss.single_point_options import SinglePointOptions
from navlearn.states import GnssFix, SatelliteRanges


@torch.no_grad()
def first_tight_guess(
    model: TightModel,
    start: TightBelief[Any],
    reception: Reception,
    passes: VehiclePasses[Any],
) -> TightBelief[Any]:
    """Return guesses of the beliefs at which blocks start.

    Args:
        model: The filter.
        start: Belief before the first sample, batch shape (B,).
        reception: What was received at the end of each block, batch shape (B, K).
        passes: The vehicle's side of the blocks.

    Returns:
        Beliefs, batch shape (B, K); the first is the start itself, covariance and refusals are
        those of the start.
    """
    start, reception = map_tree((start, reception), Tensor.detach)
    options = SinglePointOptions(
        noise=model.options.range_noise, elevation_mask=model.options.elevation_mask
    )
    found, moving = _each_by_itself(model, reception.ranges, options)
    one = torch.ones_like(found.lat)
    fix = GnssFix(
        found.lat,
        found.lon,
        found.height,
        moving.v_l[..., 0],
        moving.v_l[..., 1],
        moving.v_l[..., 2],
        std_e=one,
        std_n=one,
        std_u=one,
        std_v=one,
        has_position=found.ok.to(one),
        has_velocity=(found.ok & moving.ok).to(one),
    )
    drift = torch.where(fix.has_velocity > 0.5, moving.drift, torch.nan)
    clock = clocks_between(start.clock, found, drift, reception)
    count = reception.elapsed.shape[1]

    def held(x: Tensor) -> Tensor:
        return x.unsqueeze(1).expand(x.shape[0], count, *x.shape[1:])

    return TightBelief(passes.guess(fix), clock, held(start.covariance), held(start.refused))


def _each_by_itself(
    model: TightModel, ranges: SatelliteRanges, options: SinglePointOptions
) -> tuple[SinglePoint, RangeRateVelocity]:
    """Return position and velocity at each reception, batch shape (B, K)."""
    # systems are told per reception here, so that each is a drive of its own
    lone = SatelliteRanges(*(channel.unsqueeze(2) for channel in ranges))
    lone = lone._replace(system=ranges.system)
    found = single_point(lone, options, systems=model.systems)
    moving = range_rate_velocity(lone, (found.lat, found.lon, found.height), options)
    return (
        SinglePoint(*(channel.squeeze(2) for channel in found)),
        RangeRateVelocity(*(channel.squeeze(2) for channel in moving)),
    )


def clocks_between(
    start: Tensor, found: SinglePoint, drift: Tensor, reception: Reception
) -> Tensor:
    """Return clock states at the starts of blocks, carried on from what was last known.

    Args:
        start: Clock before the first block, shape (B, c).
        found: Single-point solutions at the ends of blocks, shape (B, K).
        drift: Drift of the clock there, NaN where it is not known, m/s, shape (B, K).
        reception: What was received, batch shape (B, K).

    Returns:
        Shape (B, K, c).
    """
    time = torch.cumsum(reception.elapsed, 1)
    at = time - reception.delay
    rate, _ = _last(drift, start[:, DRIFT])
    known = torch.where(found.ok, found.clock[..., 0], torch.nan)
    bias, since = _last(known, start[:, BIAS], at)
    further = []
    for j in range(1, found.clock.shape[-1]):
        told = found.ok & torch.isfinite(found.clock_std[..., j])
        value = torch.where(told, found.clock[..., j], torch.nan)
        further.append(_last(value, start[:, DRIFT + j])[0])
    clock = torch.stack((bias + rate * (time - since), rate, *further), -1)
    return torch.cat((start.unsqueeze(1), clock[:, :-1]), 1)


def _last(values: Tensor, first: Tensor, at: Tensor | None = None) -> tuple[Tensor, Tensor]:
    """Return the last value that is no NaN up to each block, and since when it holds."""
    whole = torch.cat((first.unsqueeze(1), values), 1)
    place = torch.arange(whole.shape[1], device=whole.device).expand(whole.shape)
    last = torch.where(torch.isnan(whole), 0, place).cummax(1).values[:, 1:]
    stamps = torch.zeros_like(values) if at is None else at
    stamps = torch.nn.functional.pad(stamps, (1, 0))
    return torch.gather(whole, 1, last), torch.gather(stamps, 1, last)
