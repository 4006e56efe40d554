"""The simplified error model of [Dahmane2022] §2.2, its slips repaired, turned from NED to ENU.

The Earth is a ball of radius R_e, the transport rate is left out where it multiplies an error, and
only height feels gravity's gradient. Repaired: position errors are metres, so that (7) to (9)
hold; height and its velocity count upwards, and (10) drives them apart at τ = √(R/2g) = 570 s;
(11) is antisymmetric, as a Coriolis term is; (12) has the specific force itself (f_D + 2g is it at
rest, and only there); what is printed twice as F_ρρ is F_ρp in (13); errors are estimate minus
truth. As in Table 1, with Q_d = G Q Gᵀ Δt.
"""

import math
from typing import Final

import torch
from torch import Tensor

from navlearn import earth
from navlearn.fusion.ins.error_dynamics import Motion, skew, with_sensors
from navlearn.fusion.ins.layout import ImuErrors, InsLayout

EARTH_RADIUS: Final = 6372795.5
"""R_e, m."""

VERTICAL_TIME: Final = math.sqrt(EARTH_RADIUS / (2.0 * 9.80665))
"""τ_D = √(R/2g), s; printed as 520 s, it is 570 s."""


def dahmane2022_dynamics(
    layout: InsLayout, motion: Motion, errors: ImuErrors, tau: float
) -> Tensor:
    """Return F of the simplified model; with 9 states it is that of the paper.

    [Dahmane2022] Eq. (6) to (15).

    Args:
        layout: Order of the error states.
        motion: Motion, batch shape (...).
        errors: Sensor parameters, batch shape (...).
        tau: Correlation time of the biases, s; infinite for random walks.

    Returns:
        F, 1/s, shape (..., n, n).
    """
    rate = earth.earth_rate_enu(motion.lat)
    force = (motion.C_lb @ motion.f_b.unsqueeze(-1)).squeeze(-1)
    core = motion.lat.new_zeros((*motion.lat.shape, 9, 9))
    eye = torch.eye(3, dtype=core.dtype, device=core.device)
    core[..., 0:3, 3:6] = eye
    core[..., 5, 2] = 1.0 / VERTICAL_TIME**2
    core[..., 3:6, 3:6] = -2.0 * skew(rate)
    core[..., 3:6, 6:9] = -skew(force)
    core[..., 6, 4] = 1.0 / EARTH_RADIUS
    core[..., 7, 3] = -1.0 / EARTH_RADIUS
    core[..., 6:9, 6:9] = -skew(rate)
    return with_sensors(layout, core, motion, errors, tau)
