"""Candidate cascades of parallel cascade identification, many at once.

Source: [Iqbal2020, IV] after [Korenberg1991]. A candidate is a linear element, read off a
cross-correlation of inputs and residual, followed by a polynomial. The polynomials are fitted on
orthonormal polynomials of the data (three-term recurrence), never on powers. With several
inputs, a response reads one channel or all of them, and slices may come from any channel. B
windows are treated at once, each with its own rows, on the same draws.
"""

from typing import NamedTuple

import torch
from torch import Tensor


class Draw(NamedTuple):
    """What is drawn at random for M candidates.

    Attributes:
        order: Order of the cross-correlation, 1 to 3, shape (M,).
        slices: Columns of the lagged inputs at A1 and A2, shape (M, 2).
        signs: Signs of the added deltas, shape (M, 2).
        reads: True for the columns that the cross-correlation fills, shape (M, L).
    """

    order: Tensor
    slices: Tensor
    signs: Tensor
    reads: Tensor


class Cascades(NamedTuple):
    """K cascades: linear responses, and polynomials in their orthonormal bases.

    Attributes:
        response: Responses by column of the lagged inputs, unit output power, shape (K, L).
        shift: α of the recurrence, shape (K, D).
        norm: β of the recurrence, shape (K, D).
        weight: Coefficients of the basis polynomials, shape (K, D + 1).
        low: Smallest linear output in training, shape (K,).
        high: Largest linear output in training, shape (K,).
    """

    response: Tensor
    shift: Tensor
    norm: Tensor
    weight: Tensor
    low: Tensor
    high: Tensor


def draw_candidates(
    count: int, order: int, lags: int, inputs: int, generator: torch.Generator
) -> Draw:
    """Draw candidates; the first of several is always of first order and reads all channels.

    A single one is drawn like any other. Columns of the lagged inputs are ordered by lag, then
    channel.

    Args:
        count: Number of candidates M.
        order: Highest order.
        lags: Largest lag R.
        inputs: Number of channels m.
        generator: Source of chance.
    """
    columns = (lags + 1) * inputs
    orders = torch.randint(1, order + 1, (count,), generator=generator)
    slices = torch.randint(0, columns, (count, 2), generator=generator)
    signs = 2.0 * torch.randint(0, 2, (count, 2), generator=generator).double() - 1.0
    channel = torch.randint(0, inputs, (count, 1), generator=generator)
    every = torch.randint(0, 2, (count, 1), generator=generator) == 1
    if count > 1:
        orders[0] = 1
        every[0] = True
    reads = every | (torch.arange(columns) % inputs == channel)
    return Draw(orders, slices, signs, reads)


def linear_responses(lagged: Tensor, residual: Tensor, root: Tensor, c: Tensor, d: Draw) -> Tensor:
    """Return the responses before normalisation, shape (B, M, L).

    First order is φ_xy(j); second φ_xxy(j, A) ± c δ(j − A); third φ_xxxy(j, A1, A2)
    ± c δ(j − A1) ± c δ(j − A2).

    Args:
        lagged: Lagged inputs of each window, shape (B, N, L).
        residual: Residual before this cascade, times ``root``, shape (B, N).
        root: Root of the weight of each row, of squared sum 1, shape (B, N).
        c: Size of the deltas, shape (B,).
        d: What was drawn.
    """
    columns = lagged.mT
    # A row of ones after the columns stands for the factor that a lower order does not have.
    columns = torch.cat((columns, torch.ones_like(columns[:, :1])), 1)
    places = torch.where(d.order.unsqueeze(-1) > torch.tensor([1, 2]), d.slices, lagged.shape[-1])
    product = columns[:, places[:, 0]] * (root * residual).unsqueeze(-2)
    product = product * columns[:, places[:, 1]]
    response = (product @ lagged) * d.reads
    for k in (0, 1):
        size = c.unsqueeze(-1) * d.signs[:, k] * (d.order > k + 1)
        place = d.slices[:, k : k + 1].expand(size.shape[0], -1, 1)
        response = response.scatter_add(2, place, size.unsqueeze(-1))
    return response


def fit_cascades(
    lagged: Tensor, residual: Tensor, root: Tensor, response: Tensor, degree: int
) -> tuple[Cascades, Tensor]:
    """Scale every response to unit output power and fit its polynomial to the residual.

    Args:
        lagged: Lagged inputs of each window, shape (B, N, L).
        residual: What the polynomials are fitted to, times ``root``, shape (B, N).
        root: Root of the weight of each row, of squared sum 1, shape (B, N).
        response: Responses, shape (B, M, L).
        degree: Degree D.

    Returns:
        The cascades, axes (B, M, ...), and mean(z²) of each, shape (B, M); 0 for one without any
        output. The range of their outputs is left open.
    """
    u = response @ lagged.mT
    weighted = root.unsqueeze(-2)
    spread = torch.linalg.vector_norm(u * weighted, dim=-1, keepdim=True)
    alive = spread > 1e-12 * torch.linalg.vector_norm(response, dim=-1, keepdim=True)
    scale = alive / torch.where(alive, spread, torch.ones_like(spread))
    u, response = u * scale, response * scale
    target = residual.unsqueeze(-1)
    before, here = torch.zeros_like(u), weighted.expand_as(u)
    beta = torch.zeros_like(spread)
    shifts, norms, weights = [], [], [(here[:, :1] @ target).expand(-1, u.shape[1], 1)]
    for _ in range(degree):
        ahead = u * here
        alpha = torch.linalg.vecdot(ahead, here).unsqueeze(-1)
        ahead.addcmul_(alpha, here, value=-1.0).addcmul_(beta, before, value=-1.0)
        beta = torch.linalg.vector_norm(ahead, dim=-1, keepdim=True)
        # A linear output of few distinct values spans no more polynomials than it has values.
        more = beta > 1e-10
        beta = torch.where(more, beta, torch.ones_like(beta))
        before, here = here, ahead.mul_(more / beta)
        shifts.append(alpha)
        norms.append(beta)
        weights.append(here @ target)
    weight = torch.cat(weights, -1) * alive
    wide = torch.full_like(spread.squeeze(-1), torch.inf)
    fitted = Cascades(response, torch.cat(shifts, -1), torch.cat(norms, -1), weight, -wide, wide)
    return fitted, (weight * weight).sum(-1)


def basis(u: Tensor, shift: Tensor, norm: Tensor) -> Tensor:
    """Return the orthonormal polynomials of each cascade's linear output.

    Args:
        u: Linear outputs, shape (..., K).
        shift: α, shape (..., K, D).
        norm: β, shape (..., K, D).

    Returns:
        Shape (..., K, D + 1).
    """
    before, here = torch.zeros_like(u), torch.ones_like(u)
    rows = [here]
    for d in range(shift.shape[-1]):
        ahead = (u - shift[..., d]) * here
        if d > 0:
            ahead = ahead - norm[..., d - 1] * before
        before, here = here, ahead / norm[..., d]
        rows.append(here)
    return torch.stack(rows, -1)
