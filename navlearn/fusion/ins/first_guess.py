"""Where the fast form starts its iteration: attitudes good to a few degrees.

The gyros alone give the attitude up to a slowly growing rotation. That rotation shows between what
the accelerometers felt, turned by the gyros, and what fixes say of velocity, and between the car's
forward axis and its course: pairs of vectors, from which [Markley1988] finds it by a singular
value decomposition. A guess needs no gradient, and nothing in the result depends on it.
"""

import torch
from torch import Tensor

from navlearn import earth
from navlearn.attitude import (
    angles_from_matrix,
    matrix_from_angles,
    matrix_from_quaternion,
    quaternion_from_angles,
    quaternion_from_rotation_vector,
    quaternion_multiply,
)
from navlearn.filters.ins_belief import InsBelief
from navlearn.fusion.ins.model import InsFilterModel
from navlearn.fusion.ins.timeline import InsTimeline
from navlearn.fusion.straight_lines import positions_between, straight_lines
from navlearn.mechanization.preintegration import Preintegrated
from navlearn.mechanization.preintegration_turn import prefix_products
from navlearn.states import InsState

WINDOW = 20
"""Blocks before and after, of which the rotation of the gyros' attitude is found."""

FAST = 4.0
"""Slowest speed at which a course tells the direction of the forward axis, m/s."""

FORWARD = 3.0
"""Weight of the forward axis beside specific forces, m/s of velocity increment."""

ACROSS = 60.0
"""Second singular value from which a window tells a rotation: one needs more than gravity."""

LONGEST = 5.0
"""Longest time between fixes over which velocity is taken as linear, s."""


def first_ins_guess(
    model: InsFilterModel, start: InsBelief, line: InsTimeline, pre: Preintegrated
) -> InsBelief:
    """Return guesses of the beliefs at which blocks start.

    Args:
        model: The filter.
        start: Belief before the first sample, batch shape (B,).
        line: The drives in blocks.
        pre: Increments of all blocks with the start's sensor parameters, batch shape (B, K).

    Returns:
        Beliefs, batch shape (B, K); the first is the start itself, covariance and refusals are
        those of the start.
    """
    count = line.blocks.end.shape[1]

    def held(x: Tensor) -> Tensor:
        return x.detach().unsqueeze(1).expand(x.shape[0], count, *x.shape[1:])

    start = InsBelief(
        InsState(*(x.detach() for x in start.state)), *(x.detach() for x in start[1:])
    )
    told, sure = told_by_fixes(start.state, line, pre.duration)
    q_lb = turned_by_gyros(start.state, pre)
    C_lb = matrix_from_quaternion(q_lb)
    drift = drift_of_gyros(model, C_lb, pre, told, sure)
    q_lb = quaternion_from_angles(*angles_from_matrix(drift @ C_lb))
    begin = (*told[..., :-1, :3].unbind(-1), told[..., :-1, 3:], q_lb)
    state = InsState(
        *(
            torch.cat((first.unsqueeze(1), x[:, 1:]), 1)
            for first, x in zip(start.state, begin, strict=True)
        )
    )
    return InsBelief(state, *(held(x) for x in start[1:]))


def told_by_fixes(start: InsState, line: InsTimeline, duration: Tensor) -> tuple[Tensor, Tensor]:
    """Return what fixes say between blocks, by straight lines from the start on.

    Args:
        start: State before the first block, batch shape (B,).
        line: The drives in blocks.
        duration: Length of the blocks, s, shape (B, K).

    Returns:
        Latitude, longitude, height and velocity at the starts of blocks and the end of the last,
        shape (B, K + 1, 6); 1.0 where velocity is known through a block, shape (B, K).
    """
    fix, delay = line.occasion.fix, line.occasion.delay
    where = positions_between((start.lat, start.lon, start.height), fix, delay, duration)
    velocity = torch.stack((fix.v_e, fix.v_n, fix.v_u), -1)
    moving = straight_lines(start.v_l, velocity, fix.has_velocity > 0.5, delay, duration)
    return torch.cat((where.told, moving.told), -1), (moving.gap <= LONGEST).to(duration)


def turned_by_gyros(start: InsState, pre: Preintegrated) -> Tensor:
    """Return the attitude at the starts of blocks by the gyros alone, the Earth standing still.

    Args:
        start: State before the first block, batch shape (B,).
        pre: Increments, batch shape (B, K).

    Returns:
        Quaternion, shape (B, K, 4).
    """
    time = torch.cumsum(pre.duration, 1) - pre.duration
    w, x, y, z = (channel.contiguous() for channel in pre.rotation.unbind(-1))
    after = torch.stack(prefix_products((w, x, y, z)), -1)
    before = torch.cat((torch.zeros_like(after[:, :1]), after[:, :-1]), 1)
    before[:, 0, 0] = 1.0
    of_earth = -earth.earth_rate_enu(start.lat).unsqueeze(1) * time.unsqueeze(-1)
    turn = quaternion_from_rotation_vector(of_earth)
    return quaternion_multiply(quaternion_multiply(turn, start.q_lb.unsqueeze(1)), before)


def drift_of_gyros(
    model: InsFilterModel, C_lb: Tensor, pre: Preintegrated, told: Tensor, sure: Tensor
) -> Tensor:
    """Return the rotation that the gyros' attitude lacks.

    Args:
        model: The filter.
        C_lb: Attitude by the gyros at the starts of blocks, shape (B, K, 3, 3).
        pre: Increments, batch shape (B, K).
        told: What fixes say, shape (B, K + 1, 6).
        sure: 1.0 where they say it through a block, shape (B, K).

    Returns:
        Rotation matrices to be put in front; held where a window tells none, (B, K, 3, 3).
    """
    velocity = told[..., 3:]
    felt = (C_lb @ pre.velocity.unsqueeze(-1)).squeeze(-1)
    fallen = earth.normal_gravity(told[:, :-1, 0], told[:, :-1, 2]) * pre.duration
    seen = velocity[:, 1:] - velocity[:, :-1]
    seen = seen + torch.nn.functional.pad(fallen.unsqueeze(-1), (2, 0))
    pairs = seen.unsqueeze(-1) * felt.unsqueeze(-2)
    if model.options.nonholonomic:
        mounting = torch.tensor(model.options.mounting, dtype=felt.dtype, device=felt.device)
        ahead = (C_lb @ matrix_from_angles(*mounting.unbind(0))[1].unsqueeze(-1)).squeeze(-1)
        speed = velocity[:, :-1].norm(dim=-1, keepdim=True)
        course = velocity[:, :-1] / speed.clamp(min=FAST) * (speed > FAST)
        pairs = pairs + FORWARD**2 * course.unsqueeze(-1) * ahead.unsqueeze(-2)
    sums = torch.cumsum(pairs * sure[..., None, None], 1)
    K = sums.shape[1]
    place = torch.arange(K)
    last, first = (place + WINDOW).clamp(max=K - 1), place - WINDOW - 1
    window = sums[:, last] - torch.where(
        (first >= 0).view(-1, 1, 1), sums[:, first.clamp(min=0)], 0.0
    )
    U, S, Vh = torch.linalg.svd(window)
    proper = torch.ones_like(S)
    proper[..., 2] = torch.linalg.det(U @ Vh)
    found = U @ (proper.unsqueeze(-1) * Vh)
    usable = torch.where(S[..., 1] > ACROSS, place, -1).cummax(1).values
    eye = torch.eye(3, dtype=found.dtype, device=found.device)
    chosen = torch.gather(found, 1, usable.clamp(min=0)[..., None, None].expand_as(found))
    return torch.where((usable >= 0)[..., None, None], chosen, eye)
