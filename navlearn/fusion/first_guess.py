"""Where the fast form starts its iteration: azimuths good to a few degrees.

Position hardly matters to how a block moves the car, azimuth does. The gyro alone gives the
shape of the drive, turned by a slowly growing angle; that angle shows between the chord of two
fixes and the chord of the dead-reckoned way between them. A guess needs no gradient, and nothing
in the result depends on it.
"""

import numpy as np
import torch
from torch import Tensor

from navlearn import wgs84
from navlearn.attitude import wrap_angle
from navlearn.filters.belief import Belief
from navlearn.fusion.filter_model import FilterModel
from navlearn.fusion.timeline import Timeline
from navlearn.states import NavState

WINDOW = 20
"""Fixes between the two ends of a chord."""

SHORTEST = 40.0
"""Shortest chord that tells a direction, m."""


def first_guess(model: FilterModel, start: Belief, line: Timeline) -> Belief:
    """Return guesses of the beliefs at which blocks start.

    Args:
        model: The filter.
        start: Belief before the first sample, batch shape (B,).
        line: The drives in blocks.

    Returns:
        Beliefs, batch shape (B, K); covariance and refusals are those of the start.
    """
    count = line.blocks.end.shape[1]

    def held(x: Tensor) -> Tensor:
        return x.detach().unsqueeze(1).expand(x.shape[0], count, *x.shape[1:])

    samples, state = line.samples, start.state
    rate = -samples.yaw_rate + (model.earth_rate * torch.sin(state.lat))[:, None, None]
    if len(model.errors.gyro_terms) > 0:
        first = model.layout.sensors.index("gyro_bias") if _has_bias(model) else -1
        rate = rate + (start.sensor[:, first, None, None] if first >= 0 else 0.0)
    turn = (rate * samples.dt).sum(-1).detach()
    azimuth = state.azimuth.detach().unsqueeze(1) + torch.cumsum(turn, 1) - turn
    way = (samples.speed * samples.dt).sum(-1).detach()
    azimuth = azimuth + _drift(azimuth + 0.5 * turn, way, state.lon, line)
    others = [held(x) for x in start[1:]]
    held_state = NavState(*(held(x) for x in start.state))
    return Belief(held_state._replace(azimuth=azimuth), *others)


def _has_bias(model: FilterModel) -> bool:
    return "gyro_bias" in model.layout.sensors


def _drift(heading: Tensor, way: Tensor, origin: Tensor, line: Timeline) -> Tensor:
    fix = line.occasion.fix
    usable = (fix.has_position > 0.5) & torch.isfinite(fix.lat) & torch.isfinite(fix.lon)
    radius = wgs84.SEMI_MAJOR_AXIS
    # one scale for the whole drive: chords are short, and only their direction counts
    around = wrap_angle(fix.lon - origin.unsqueeze(1))
    east = radius * torch.cos(fix.lat.mean(1, keepdim=True)) * around
    channels = (
        usable,
        torch.cumsum(way * torch.sin(heading), 1),
        torch.cumsum(way * torch.cos(heading), 1),
        east.detach(),
        (radius * fix.lat).detach(),
    )
    rows = zip(*(channel.cpu().numpy() for channel in channels), strict=True)
    return torch.from_numpy(np.stack([_drift_of_row(*row) for row in rows])).to(way)


def _drift_of_row(
    usable: np.ndarray, x: np.ndarray, y: np.ndarray, east: np.ndarray, north: np.ndarray
) -> np.ndarray:
    """Return the angle by which a gyro-only track lags the fixes at each block's start.

    Fixes on both sides of a block are looked at: what a guess knows never shows in the result.
    """
    drift = np.zeros(len(x))
    late = np.flatnonzero(usable)
    if len(late) < 2:
        return drift
    early = late[np.maximum(np.arange(len(late)) - WINDOW, 0)]
    reckoned = np.hypot(x[late] - x[early], y[late] - y[early])
    seen = np.hypot(east[late] - east[early], north[late] - north[early])
    told = (reckoned > SHORTEST) & (np.abs(seen - reckoned) < 0.3 * reckoned)
    late, early = late[told], early[told]
    if len(late) == 0:
        return drift
    middle = 0.5 * (late + early)
    chord = np.arctan2(east[late] - east[early], north[late] - north[early])
    track = np.arctan2(x[late] - x[early], y[late] - y[early])
    angle = np.unwrap((chord - track + np.pi) % (2.0 * np.pi) - np.pi)
    guess: np.ndarray = np.interp(np.arange(len(x)), np.append(-1.0, middle), np.append(0.0, angle))
    return guess
