"""The simplified error model of [Dahmane2022] §2.2, its slips repaired, turned from NED to ENU.

The Earth is a ball of radius R_e, the transport rate is left out where it multiplies an error, and
only height feels gravity's gradient. Repaired: position errors are metres, so that (7) to (9)
hold; height and its velocity count upwards, and (10) drives them apart at τ = √(R/2g) = 570 s;
(11) is antisymmetric, as a Coriolis term is; (12) has the specific force itself (f_D + 2g is it at
rest, and only there); what is printed twice as F_ρρ is F_ρp in (13); errors are estimate minus
truth. As in Table 1, with Q_d = G Q Gᵀ Δt.
"""

import math

import torch
from torch import Tensor

from navlearn import earth
from navlearn.fusion.ins.error_dynamics import Motion
from navlearn.mechanization.preintegration_sums import skew

EARTH_RADIUS: float = 6372795.5
"""R_e, m."""

VERTICAL_TIME: float = math.sqrt(EARTH_RADIUS / (2.0 * 9.80665))
"""τ_D = √(R/2g), s; printed as 520 s, it is 570 s."""


def dahmane2022_dynamics(
    motion: Motion, radius: float = EARTH_RADIUS, vertical_time: float = VERTICAL_TIME
) -> Tensor:
    """Return F of position, velocity and attitude errors in the simplified model; scriptable.

    [Dahmane2022] Eq. (6) to (15).

    Args:
        motion: Motion, batch shape (...).
        radius: Of the Earth, m.
        vertical_time: τ_D, s.

    Returns:
        F, 1/s, shape (..., 9, 9).
    """
    rate = earth.earth_rate_enu(motion.lat)
    force = (motion.C_lb @ motion.f_b.unsqueeze(-1)).squeeze(-1)
    zero = torch.zeros_like(motion.C_lb)
    eye = torch.eye(3, dtype=zero.dtype, device=zero.device)
    fall, level = torch.zeros_like(eye), torch.zeros_like(eye)
    fall[2, 2] = 1.0 / (vertical_time * vertical_time)
    level[0, 1], level[1, 0] = 1.0 / radius, -1.0 / radius
    top = torch.cat((zero, eye.expand_as(zero), zero), -1)
    middle = torch.cat((fall.expand_as(zero), -2.0 * skew(rate), -skew(force)), -1)
    low = torch.cat((zero, level.expand_as(zero), -skew(rate)), -1)
    return torch.cat((top, middle, low), -2)
