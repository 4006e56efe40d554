"""Which of many correlated measurements agree: the worst is taken out until the rest does.

All ranges share a clock and a position, so their innovations are correlated. Judged one by one
against the prediction, a fault hides behind an uncertain clock; judged together, one fault drags
the others along. Both are cured by asking of each measurement how far it lies from what the
prediction *and all others* say of it [Baarda1968]: with J the inverse of the innovations'
covariance and u = J ν that distance squared over its variance is u_i² / J_ii, χ² with one degree
of freedom. Of a single fault this square is the largest, however it drags the others. The largest
beyond the limit is taken out, which turns J into J − J_i J_iᵀ / J_ii, and the rest are judged anew.
"""

from typing import NamedTuple

import torch
from torch import Tensor


class Agreement(NamedTuple):
    """Which measurements agree with the prediction and with each other.

    Attributes:
        accepted: Whether they do, bool, shape (..., r).
        square: Squared distance from what prediction and accepted others say, over its variance;
            of one taken out that at which it went; shape (..., r).
    """

    accepted: Tensor
    square: Tensor


@torch.no_grad()
def agreement(innovation: Tensor, spread: Tensor, there: Tensor, limit: float) -> Agreement:
    """Return which measurements agree.

    Args:
        innovation: Measured minus predicted, zero where nothing is measured, shape (..., r).
        spread: Covariance of the innovations, R included, with unit variance and no correlation
            where nothing is measured, shape (..., r, r).
        there: Whether something is measured, bool, shape (..., r).
        limit: Largest square that passes; infinite lets everything pass.

    Returns:
        Agreement; where a spread is no covariance nothing agrees, with infinite squares.
    """
    factor, wrong = torch.linalg.cholesky_ex(spread)
    sound = (wrong == 0).unsqueeze(-1)
    unit = torch.eye(spread.shape[-1], dtype=spread.dtype, device=spread.device)
    J = torch.cholesky_inverse(torch.where(sound.unsqueeze(-1), factor, unit))
    u = (J @ innovation.unsqueeze(-1)).squeeze(-1)
    accepted, gone = there & sound, torch.where(there & ~sound, torch.inf, 0.0 * innovation)
    for _ in range(innovation.shape[-1]):
        square = _squares(J, u, accepted)
        # not a number is beyond every limit
        ranked = torch.nan_to_num(square, nan=torch.inf)
        worst = ranked.argmax(-1, keepdim=True)
        out = ~(torch.gather(ranked, -1, worst) <= limit)
        if not bool(out.any()):
            break
        here = torch.zeros_like(accepted).scatter(-1, worst, out)
        accepted, gone = accepted & ~here, torch.where(here, square, gone)
        J, u = _without(J, u, worst, out)
    return Agreement(accepted, torch.where(accepted, _squares(J, u, accepted), gone))


def _squares(J: Tensor, u: Tensor, accepted: Tensor) -> Tensor:
    own = J.diagonal(dim1=-2, dim2=-1)
    return torch.where(accepted, u * u / torch.where(accepted, own, 1.0), 0.0)


def _without(J: Tensor, u: Tensor, worst: Tensor, out: Tensor) -> tuple[Tensor, Tensor]:
    """Return J and u of the others, where one is to go out."""
    column = torch.gather(J, -1, worst.unsqueeze(-2).expand(*J.shape[:-1], 1))
    own = torch.gather(column, -2, worst.unsqueeze(-1))
    share = torch.where(out.unsqueeze(-1), column / own, 0.0)
    told = torch.gather(u, -1, worst)
    return J - share @ column.transpose(-1, -2), u - share.squeeze(-1) * told
