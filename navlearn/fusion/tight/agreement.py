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
    count = innovation.shape[-1]
    factor, wrong = torch.linalg.cholesky_ex(spread)
    sound = (wrong == 0).unsqueeze(-1)
    unit = torch.eye(count, dtype=spread.dtype, device=spread.device)
    J = torch.cholesky_inverse(torch.where(sound.unsqueeze(-1), factor, unit))
    u = (J @ innovation.unsqueeze(-1)).reshape(-1, count)
    J, accepted = J.reshape(-1, count, count), (there & sound).reshape(-1, count)
    squares = torch.where(there & ~sound, torch.inf, 0.0 * innovation).reshape(-1, count)
    kept, at = accepted.clone(), torch.arange(len(u), device=u.device)
    while True:
        square = _squares(J, u, accepted)
        squares[at] = torch.where(accepted, square, squares[at])
        # not a number is beyond every limit
        ranked = torch.nan_to_num(square, nan=torch.inf)
        worst = ranked.argmax(-1, keepdim=True)
        out = ~(torch.gather(ranked, -1, worst) <= limit).squeeze(-1)
        if not bool(out.any()):
            return Agreement(kept.view(there.shape), squares.view(there.shape))
        # most receptions are done after the first look: the others are looked at by themselves
        at, worst, accepted = at[out], worst[out], accepted[out].scatter(-1, worst[out], False)
        kept[at] = accepted
        J, u = _without(J[out], u[out], worst)


def _squares(J: Tensor, u: Tensor, accepted: Tensor) -> Tensor:
    own = J.diagonal(dim1=-2, dim2=-1)
    return torch.where(accepted, u * u / torch.where(accepted, own, 1.0), 0.0)


def _without(J: Tensor, u: Tensor, worst: Tensor) -> tuple[Tensor, Tensor]:
    """Return J and u of the others, where one is to go out."""
    column = torch.gather(J, -1, worst.unsqueeze(-2).expand(*J.shape[:-1], 1))
    own = torch.gather(column, -2, worst.unsqueeze(-1))
    share, told = column / own, torch.gather(u, -1, worst)
    return J - share @ column.transpose(-1, -2), u - share.squeeze(-1) * told
