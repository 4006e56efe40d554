"""How a path bends when gravity is a little other than assumed, on few nodes.

δ̈ = a + Γ δ − 2 ω_ie × δ̇ with a given at nodes and linear between them: the correction is as
smooth as gravity along the path, so some hundred nodes per chunk tell it, and a cubic between two
nodes brings it to every sample. Vectors lie as (3, records, nodes).
"""

from typing import NamedTuple

import torch
from torch import Tensor

from navlearn import wgs84

NODES = 128
"""Nodes of a chunk that is long enough."""


class Nodes(NamedTuple):
    """Where the nodes of a chunk lie: the middles of every ``stride``-th interval, and the last.

    Attributes:
        stride: Intervals from node to node.
        step: Time from the node before, s, shape (B, m); the first counts from the start.
        at_middle: Time of each interval's middle since the node before, s, shape (B, m, stride);
            behind the last interval it holds anything.
        at_end: The same of each interval's end.
    """

    stride: int
    step: Tensor
    at_middle: Tensor
    at_end: Tensor


class Bend(NamedTuple):
    """A correction as a cubic behind every node: values at the node before, (3, B, m) each.

    Attributes:
        x: Correction of the way, m.
        v: Its rate, m/s.
        a: Half its second derivative, m/s².
        j: A sixth of its third derivative, m/s³.
    """

    x: Tensor
    v: Tensor
    a: Tensor
    j: Tensor


def nodes_of(dt: Tensor) -> Nodes:
    """Return the nodes of a chunk.

    Args:
        dt: Length of the intervals, s, shape (B, n).

    Returns:
        Nodes, not more than about :data:`NODES`.
    """
    n = dt.shape[-1]
    stride = max(n // NODES, 1)
    ends = torch.cumsum(dt, -1)
    middles = ends - 0.5 * dt
    at_nodes = picked(middles, stride)
    before = torch.nn.functional.pad(at_nodes[:, :-1], (1, 0)).unsqueeze(-1)
    spare = before.shape[1] * stride - n
    laid = [
        torch.nn.functional.pad(x, (0, spare)).view(len(dt), -1, stride) - before
        for x in (middles, ends)
    ]
    return Nodes(stride, at_nodes - before.squeeze(-1), *laid)


def picked(channel: Tensor, stride: int) -> Tensor:
    """Return a channel at the nodes.

    Args:
        channel: Values of all intervals, shape (..., n).
        stride: Intervals from node to node.

    Returns:
        Values, shape (..., m).
    """
    whole = channel[..., stride - 1 :: stride]
    if channel.shape[-1] % stride == 0:
        return whole
    return torch.cat((whole, channel[..., -1:]), -1)


def sloping(gravity: Tensor, slope: Tensor, way: Tensor) -> Tensor:
    """Return gravity a way off, linear in it.

    Args:
        gravity: Where the way starts, m/s², shape (3, B, n or 1).
        slope: Derivative of gravity along each axis, 1/s², shape (3, 3, B, 1), the axis first.
        way: Way, m, shape (3, B, n).

    Returns:
        Gravity, shape (3, B, n).
    """
    for along, distance in zip(slope.unbind(0), way.unbind(0), strict=True):
        gravity = torch.addcmul(gravity, along, distance)
    return gravity


def bend(push: Tensor, slope: Tensor, step: Tensor, passes: int) -> Bend:
    """Return the correction that an additional acceleration makes.

    Args:
        push: Acceleration at the nodes, m/s², shape (3, B, m); zero at the start.
        slope: Derivative of gravity along each axis, 1/s², shape (3, 3, B, 1).
        step: Time from the node before, s, shape (B, m).
        passes: Picard passes: the first takes the acceleration alone.

    Returns:
        The correction.
    """
    acceleration, half, sixth = push, 0.5 * step, step * step / 6.0
    x = v = x_0 = v_0 = a_0 = push
    for k in range(passes):
        if k > 0:
            acceleration = sloping(push, slope, x) + (2.0 * wgs84.EARTH_RATE) * _across(v)
        a_0 = _before(acceleration)
        v = torch.cumsum(half * (a_0 + acceleration), -1)
        v_0 = _before(v)
        x = torch.cumsum(torch.addcmul(step * v_0, sixth, acceleration + 2.0 * a_0), -1)
        x_0 = _before(x)
    per_step = 1.0 / torch.where(step > 0.0, 6.0 * step, 1.0)
    return Bend(x_0, v_0, 0.5 * a_0, (acceleration - a_0) * per_step)


def spread(nodes: Bend, since: Tensor, count: int) -> Tensor:
    """Return the way that a correction adds at every interval.

    Args:
        nodes: The correction.
        since: Time since the node before, s, shape (B, m, stride).
        count: Intervals of the chunk.

    Returns:
        Way, m, shape (3, B, count).
    """
    x, v, a, j = (k.unsqueeze(-1) for k in nodes)
    way = torch.addcmul(a, since, j)
    way = torch.addcmul(x, since, torch.addcmul(v, since, way))
    return way.flatten(-2)[..., :count]


def spread_rate(nodes: Bend, since: Tensor, count: int) -> Tensor:
    """Return the velocity that a correction adds at every interval; see :func:`spread`."""
    _, v, a, j = (k.unsqueeze(-1) for k in nodes)
    rate = torch.addcmul(v, since, torch.addcmul(2.0 * a, since, 3.0 * j))
    return rate.flatten(-2)[..., :count]


def _across(v: Tensor) -> Tensor:
    """Return −e_z × v."""
    x, y, z = v.unbind(0)
    return torch.stack((y, -x, torch.zeros_like(z)))


def _before(x: Tensor) -> Tensor:
    return torch.nn.functional.pad(x[..., :-1], (1, 0))
