"""Candidate cascades of parallel cascade identification, many at once.

Source: [Iqbal2020, IV] after [Korenberg1991]. A candidate is a linear element, read off a
cross-correlation of inputs and residual, followed by a polynomial. The polynomials are fitted on
orthonormal polynomials of the data (three-term recurrence), never on powers. With several
inputs, a response reads one channel or all of them, and slices may come from any channel.
"""

import math
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
    """Draw candidates; the first is always of first order and reads all channels.

    Columns of the lagged inputs are ordered by lag, then channel.

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
    orders[0] = 1
    every[0] = True
    reads = every | (torch.arange(columns) % inputs == channel)
    return Draw(orders, slices, signs, reads)


def linear_responses(lagged: Tensor, residual: Tensor, share: Tensor, c: float, d: Draw) -> Tensor:
    """Return the responses before normalisation, shape (M, L).

    First order is φ_xy(j); second φ_xxy(j, A) ± c δ(j − A); third φ_xxxy(j, A1, A2)
    ± c δ(j − A1) ± c δ(j − A2).

    Args:
        lagged: Lagged inputs, shape (N, L).
        residual: Residual before this cascade, shape (N,).
        share: Weights of the rows, of sum 1, shape (N,).
        c: Size of the deltas.
        d: What was drawn.
    """
    product = (share * residual).expand(d.order.shape[0], -1)
    for k in (0, 1):
        used = (d.order > k + 1).unsqueeze(-1)
        product = torch.where(used, product * lagged[:, d.slices[:, k]].T, product)
    response = (product @ lagged) * d.reads
    for k in (0, 1):
        size = torch.where(d.order > k + 1, c * d.signs[:, k], 0.0)
        response = response.scatter_add(1, d.slices[:, k : k + 1], size.unsqueeze(-1))
    return response


def fit_cascades(
    lagged: Tensor, residual: Tensor, share: Tensor, response: Tensor, degree: int
) -> tuple[Cascades, Tensor]:
    """Scale every response to unit output power and fit its polynomial to the residual.

    Args:
        lagged: Lagged inputs, shape (N, L).
        residual: What the polynomials are fitted to, shape (N,).
        share: Weights of the rows, of sum 1, shape (N,).
        response: Responses, shape (M, L).
        degree: Degree D.

    Returns:
        The cascades, and mean(z²) of each, shape (M,); 0 for one without any output.
    """
    u = response @ lagged.T
    power = (share * u * u).sum(-1, keepdim=True)
    alive = power > 1e-24 * (response * response).sum(-1, keepdim=True)
    scale = torch.where(alive, power, torch.ones_like(power)).rsqrt() * alive
    u, response = u * scale, response * scale
    before, here = torch.zeros_like(u), torch.ones_like(u)
    beta = torch.zeros_like(power)
    shifts, norms, weights = [], [], [(share * residual * here).sum(-1)]
    for _ in range(degree):
        alpha = (share * u * here * here).sum(-1, keepdim=True)
        ahead = (u - alpha) * here - beta * before
        beta = (share * ahead * ahead).sum(-1, keepdim=True).sqrt()
        # A linear output of few distinct values spans no more polynomials than it has values.
        more = beta > 1e-10
        beta = torch.where(more, beta, torch.ones_like(beta))
        before, here = here, ahead / beta * more
        shifts.append(alpha)
        norms.append(beta)
        weights.append((share * residual * here).sum(-1))
    weight = torch.stack(weights, -1) * alive
    fitted = Cascades(
        response, torch.cat(shifts, -1), torch.cat(norms, -1), weight, u.amin(-1), u.amax(-1)
    )
    return fitted, (weight * weight).sum(-1)


def basis(u: Tensor, shift: Tensor, norm: Tensor) -> Tensor:
    """Return the orthonormal polynomials of each cascade's linear output.

    Args:
        u: Linear outputs, shape (..., K).
        shift: α, shape (K, D).
        norm: β, shape (K, D).

    Returns:
        Shape (..., K, D + 1).
    """
    before, here = torch.zeros_like(u), torch.ones_like(u)
    rows = [here]
    for d in range(shift.shape[1]):
        ahead = (u - shift[:, d]) * here
        if d > 0:
            ahead = ahead - norm[:, d - 1] * before
        before, here = here, ahead / norm[:, d]
        rows.append(here)
    return torch.stack(rows, -1)


def acceptance_threshold(
    rows: float, freedom: Tensor, candidates: int, level: float, paper: bool
) -> Tensor:
    """Return the least share of the residual's power that a candidate must explain.

    The ``paper`` test is 4 / rows. It leaves out that the response and the polynomial were fitted
    to the residual, and that the best of a batch is taken. Here the log-likelihood ratio
    −rows · ln(1 − share) is held against χ² of as many degrees of freedom as were fitted, at
    ``level`` over the number of candidates (Bonferroni). The quantile is bisected below Laurent
    and Massart's bound k + 2√(kt) + 2t, t = ln(candidates / level).

    Args:
        rows: Effective number of rows.
        freedom: Values fitted by each candidate, shape (M,).
        candidates: Number tried in the batch.
        level: Chance of a false acceptance in the batch.
        paper: Applies the test of the paper.

    Returns:
        Shape (M,).
    """
    if paper:
        return torch.full_like(freedom, 4.0 / rows)
    tail = level / candidates
    t = torch.full_like(freedom, -math.log(tail))
    low, high = torch.zeros_like(freedom), freedom + 2.0 * (freedom * t).sqrt() + 2.0 * t
    for _ in range(50):
        middle = 0.5 * (low + high)
        beyond = torch.special.gammaincc(0.5 * freedom, 0.5 * middle) > tail
        low, high = torch.where(beyond, middle, low), torch.where(beyond, high, middle)
    return -torch.expm1(-high / rows)


def effective_rows(rows: float, inputs: Tensor, residual: Tensor, share: Tensor) -> float:
    """Return the number of independent rows, after Bartlett: rows / (1 + 2 Σ ρ_x(j) ρ_y(j)).

    Two slow series agree by chance far more often than two of white noise. Lags up to a quarter
    of the record count, the channel that leaves the fewest rows decides, and rows are taken as
    neighbours in time, joints of windows too.

    Args:
        rows: Number of rows.
        inputs: Channels, shape (N, m).
        residual: What is explained, shape (N,).
        share: Weights of the rows, of sum 1, shape (N,).
    """
    count = residual.shape[0]
    series = torch.cat((residual.unsqueeze(-1), inputs), -1)
    series = series - (share.unsqueeze(-1) * series).sum(0)
    spectrum = torch.fft.rfft(series, n=2 * count, dim=0)
    lagged = torch.fft.irfft(spectrum.abs() ** 2, n=2 * count, dim=0)[: max(count // 4, 1)]
    rho = lagged / lagged[:1].clamp(min=1e-300)
    inflation = 1.0 + 2.0 * (rho[1:, :1] * rho[1:, 1:]).sum(0)
    return max(rows / max(float(inflation.max()), 1.0), 1.0)
