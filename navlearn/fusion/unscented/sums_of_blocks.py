"""Where points about a belief end up after blocks of RISS samples, told by sums over the samples.

Carrying every sigma point over every sample costs as much as so many mechanizations. But points
move alike: one that starts with another azimuth goes the same way turned, one with another odometer
scale the same way shortened, another pitch bias tips it. Gyro errors bend the way a little, which
sums of way times turn, and of way times the products of two turns, tell to second order. These sums
are taken once, along the way of the centre; each point then costs a few products per block.
"""

from typing import NamedTuple

import torch
from torch import Tensor

from navlearn.filters.belief import Belief
from navlearn.fusion.block_motion import BlockMotion
from navlearn.fusion.error_dynamics import per_tilt
from navlearn.fusion.filter_model import FilterModel
from navlearn.fusion.sensor_errors import decay_over, decaying, gyro_regressor, speed_regressor
from navlearn.states import RissSample


class BlockSums(NamedTuple):
    """Sums over the samples of blocks; J counts gyro terms, a pitch bias that tilts turns included.

    Turns are those that J terms make of the azimuth, then those of second order: pitch times pitch,
    and pitch times each gyro term.

    Attributes:
        straight: Ways by (way, turn to no and to second power), shape (..., W, 1 + J (J + 1)/2).
        bent: Ways by turn to the first power, shape (..., W, turns).
        turn: Turns at the end, shape (..., turns).
        size: Largest sum of the J terms' turns, whatever their signs, shape (..., J).
        climb: Way up, and level way: what tips up per pitch, m; then what each further odometer
            term adds to both, shape (..., C, 2).
        length: Length of the way, m, shape (...).
        transport: How the azimuth turns per way to the east, rad/m, shape (...).
    """

    straight: Tensor
    bent: Tensor
    turn: Tensor
    size: Tensor
    climb: Tensor
    length: Tensor
    transport: Tensor


def has_sums(model: FilterModel) -> bool:
    """Return whether sums tell where points end: velocity must not be a state.

    Args:
        model: The filter.
    """
    return not model.layout.has_velocity


def block_sums(
    model: FilterModel,
    belief: Belief,
    moved: BlockMotion,
    samples: RissSample,
    acceleration: Tensor,
) -> BlockSums:
    """Return the sums along the way of the centre.

    Args:
        model: The filter; see :func:`has_sums`.
        belief: Belief at the start of each block, batch shape (...).
        moved: The blocks as mechanized from there.
        samples: Their samples, shape (..., n) each.
        acceleration: Forward acceleration by the odometer, m/s², shape (..., n).

    Returns:
        Sums, batch shape (...).
    """
    errors, motion = model.errors, moved.motion
    pitch = samples.pitch - belief.sensor[..., -1:] if errors.pitch_bias else samples.pitch
    rolling = motion.v_h != 0.0
    slope = torch.where(rolling, motion.v_u / torch.where(rolling, motion.v_h, 1.0), 0.0)
    angle = per_tilt(errors, samples, pitch) * motion.dt
    turns: list[Tensor] = []
    for term in errors.gyro_terms:
        plain = angle * gyro_regressor(term, samples) if term != "bias" else angle
        decays = term == "bias" and errors.correlation_time > 0.0
        turns.append(plain * moved.decay if decays else plain)
    if _tips(model):
        tipped = motion.turn * slope
        further = [tipped * slope + 0.5 * motion.turn, *(turn * slope for turn in turns)]
        turns, count = [*turns, tipped, *further], len(turns) + 1
    else:
        count = len(turns)
    ways = [moved.east, moved.north]
    climbs = [(moved.up.sum(-1), (motion.v_h * motion.dt).sum(-1))]
    per_scale = 1.0 / _gain(model, belief.sensor)
    for term in errors.speed_terms:
        if term == "scale":
            continue
        added = speed_regressor(term, samples, acceleration) * motion.dt * per_scale.unsqueeze(-1)
        level = added * torch.cos(pitch) if errors.three_d else added
        ways += [level * moved.sine, level * moved.cosine]
        climb = added * torch.sin(pitch) if errors.three_d else torch.zeros_like(added)
        climbs.append((climb.sum(-1), level.sum(-1)))
    if errors.pitch_bias:
        ways += [slope * way for way in ways]
    W = torch.stack(ways, -2)
    length = (motion.v_h.abs() * motion.dt).sum(-1)
    straight, bent = [W.sum(-1, keepdim=True)], W[..., :0]
    turned = size = W.new_zeros((*length.shape, 0))
    if turns:
        each = torch.stack(turns, -2)
        so_far = torch.cumsum(each, -1)
        turned, middle = so_far[..., -1], so_far - 0.5 * each
        size = each[..., :count, :].abs().sum(-1)
        first = middle[..., :count, :].unbind(-2)
        pairs = torch.stack([first[i] * first[j] for i, j in _pairs(count)], -2)
        bent = W @ middle.transpose(-1, -2)
        straight.append(W @ pairs.transpose(-1, -2))
    transport = torch.tan(belief.state.lat) * moved.per_lat if model.earth_rate != 0.0 else 0.0
    return BlockSums(
        torch.cat(straight, -1),
        bent,
        turned,
        size,
        torch.stack([torch.stack(pair, -1) for pair in climbs], -2),
        length,
        transport * torch.ones_like(length),
    )


class Apart(NamedTuple):
    """Where points end.

    Attributes:
        deviation: From where the centre ends, in the order of the error state, shape (..., P, n).
        left: What terms of third order may move the worst point by, m, shape (...).
    """

    deviation: Tensor
    left: Tensor


def apart_at_ends(
    model: FilterModel, belief: Belief, sums: BlockSums, elapsed: Tensor, deviation: Tensor
) -> Apart:
    """Return where points about a belief are at the ends of blocks.

    Args:
        model: The filter.
        belief: Belief at the start of each block, batch shape (...).
        sums: Sums along the way of this belief.
        elapsed: Length of the blocks, s, shape (...).
        deviation: The points in the order of the error state, shape (..., P, n).

    Returns:
        The points at the ends.
    """
    errors, layout = model.errors, model.layout
    first, gyros = layout.first_sensor, len(errors.gyro_terms)
    own = deviation[..., first:]
    angle, pitch = deviation[..., layout.azimuth], torch.zeros_like(deviation[..., 0])
    if errors.pitch_bias:
        pitch = own[..., -1]
    terms = list(own[..., :gyros].unbind(-1))
    further: list[Tensor] = []
    if _tips(model):
        square = pitch * pitch
        further = [square, *(-term * pitch for term in terms)]
        terms = [*(term * (1.0 + 0.5 * square) for term in terms), -pitch]
    turn = _columns([*terms, *further], angle)
    one = torch.ones_like(angle)
    pairs = [(-0.5 if i == j else -1.0) * terms[i] * terms[j] for i, j in _pairs(len(terms))]
    # the way of the centre, turned by cos and sin of what gyro errors make of the azimuth
    along = _columns([one, *pairs], angle) @ sums.straight.transpose(-1, -2)
    across = turn @ sums.bent.transpose(-1, -2)
    gain = _gain(model, belief.sensor).unsqueeze(-1)
    shorter = one
    if "scale" in errors.speed_terms:
        shorter = gain / (gain + own[..., gyros + errors.speed_terms.index("scale")])
    added = [own[..., gyros + j] for j, term in enumerate(errors.speed_terms) if term != "scale"]
    level, tipped = torch.cos(pitch) * shorter, torch.sin(pitch) * shorter
    weights = [level, *(x * level for x in added)]
    if errors.pitch_bias:
        weights += [tipped, *(x * tipped for x in added)]
    share = _columns(weights, angle)
    east = (share * (along[..., 0::2] + across[..., 1::2])).sum(-1)
    north = (share * (along[..., 1::2] - across[..., 0::2])).sum(-1)
    sine, cosine = torch.sin(angle), torch.cos(angle)
    east, north = east * cosine + north * sine, north * cosine - east * sine
    up = level * _mixed(sums.climb[..., 0], added, one)
    if errors.pitch_bias:
        up = up - tipped * _mixed(sums.climb[..., 1], added, one)
    start = torch.stack((sums.straight[..., 0, 0], sums.straight[..., 1, 0]), -1).unsqueeze(-2)
    way = torch.stack((east, north), -1) - start
    climbed = up - sums.climb[..., 0, 0].unsqueeze(-1)
    turned = (turn * sums.turn.unsqueeze(-2)).sum(-1) + sums.transport.unsqueeze(-1) * way[..., 0]
    end = torch.cat(
        (
            deviation[..., :2] + way,
            torch.stack((deviation[..., 2] + climbed, angle + turned), -1),
            own * _kept(model, elapsed, own),
        ),
        -1,
    )
    return Apart(end, _left(terms, sums))


def _tips(model: FilterModel) -> bool:
    """Return whether a pitch bias changes how far the car turns."""
    return model.errors.pitch_bias and model.errors.tilt_compensation


def _pairs(count: int) -> list[tuple[int, int]]:
    return [(i, j) for i in range(count) for j in range(i, count)]


def _columns(values: list[Tensor], like: Tensor) -> Tensor:
    return torch.stack(values, -1) if values else like.new_zeros((*like.shape, 0))


def _gain(model: FilterModel, sensor: Tensor) -> Tensor:
    """Return 1 + κ, shape (...)."""
    terms = model.errors.speed_terms
    if "scale" not in terms:
        return torch.ones_like(sensor[..., :1].sum(-1))
    return 1.0 + sensor[..., len(model.errors.gyro_terms) + terms.index("scale")]


def _mixed(climb: Tensor, added: list[Tensor], one: Tensor) -> Tensor:
    return (_columns([one, *added], one) * climb.unsqueeze(-2)).sum(-1)


def _kept(model: FilterModel, elapsed: Tensor, like: Tensor) -> Tensor:
    """Return what is left of deviations of sensor parameters after the blocks."""
    if model.errors.correlation_time == 0.0:
        return like.new_ones(())
    left = decay_over(model.errors, elapsed)[..., None, None]
    return torch.where(torch.tensor(decaying(model.errors), device=like.device), left, 1.0)


def _left(terms: list[Tensor], sums: BlockSums) -> Tensor:
    """Return a sixth of the third power of the turn times the way; half of it is still ahead."""
    if not terms:
        return torch.zeros_like(sums.length)
    turn = (_columns(terms, terms[0]).abs() * sums.size.unsqueeze(-2)).sum(-1).amax(-1)
    return turn * turn * turn * sums.length / 24.0
