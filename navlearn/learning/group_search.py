"""Fast orthogonal search for terms that matter to several records, each with its own coefficients.

A gyro's errors differ from car to car in size and sign; which kinds there are is shared. So a
candidate is weighed by the error it takes away from all records together, every record with a
coefficient of its own. As in [Korenberg1989] the candidates are orthogonalised implicitly; here in
the Gram matrices, from which each chosen term is eliminated.
"""

from typing import NamedTuple

import torch
from torch import Tensor

from navlearn.errors import FitError, ShapeError
from navlearn.filters.consistency import chi_square_quantile

COLLINEAR = 1e-8
"""Share of a candidate's energy left outside the chosen terms below which it is not considered."""


class GroupSearch(NamedTuple):
    """What a search over records found.

    Attributes:
        chosen: Candidates in the order in which they were chosen.
        reduction: Energy that each took away per record, in units of its noise, shape (J, D).
        asked: Least sum of these over the records that the next term had to reach.
        next_best: What the best candidate left out would have taken away, shape (D,); zeros where
            none was left.
    """

    chosen: tuple[int, ...]
    reduction: Tensor
    asked: float
    next_best: Tensor


def search_groups(
    columns: list[Tensor], targets: list[Tensor], *, max_terms: int, false_alarm: float = 0.05
) -> GroupSearch:
    """Choose the candidates that matter over several records.

    A term is taken while the best candidate's share stands out of what the best of as many would
    reach on white noise, and while it pays: a coefficient that a record must learn by itself costs
    it twice the noise of one row, so less than two per record is a loss.

    Args:
        columns: Candidates per record, rows of independent errors, shape (N_d, M) each.
        targets: Target per record, shape (N_d,) each.
        max_terms: Most terms.
        false_alarm: Chance that white noise alone has a term accepted.

    Returns:
        The chosen terms.

    Raises:
        ShapeError: Records do not pair up or have different candidates.
        FitError: A record has hardly more rows than candidates, or a row that is not finite.
    """
    count = _checked(columns, targets)
    scale = torch.stack([x.square().mean(0).sqrt().clamp(min=1e-300) for x in columns])
    parts = [x / s for x, s in zip(columns, scale, strict=True)]
    gram = torch.stack([x.T @ x for x in parts])
    moment = torch.stack([x.T @ y for x, y in zip(parts, targets, strict=True)])
    noise = _noise(gram, moment, targets)
    whole = gram.diagonal(dim1=-2, dim2=-1).clone()
    records = len(columns)
    chosen: list[int] = []
    reductions: list[Tensor] = []
    while True:
        left = [m for m in range(count) if m not in chosen]
        asked = _asked(records, len(left), false_alarm)
        best, taken = _best(gram, moment, noise, whole, left)
        if best < 0 or len(chosen) >= max_terms or float(taken.sum()) < asked:
            break
        chosen.append(best)
        reductions.append(taken)
        gram, moment = _eliminated(gram, moment, whole, best)
    table = torch.stack(reductions) if reductions else noise.new_zeros((0, records))
    return GroupSearch(tuple(chosen), table, asked, taken)


def _checked(columns: list[Tensor], targets: list[Tensor]) -> int:
    widths = {x.shape[-1] for x in columns}
    if len(columns) != len(targets) or len(widths) != 1:
        raise ShapeError(
            f"group search: {len(columns)} records of candidates with widths {sorted(widths)} and "
            f"{len(targets)} targets; expected a target per record, and the same candidates"
        )
    count = widths.pop()
    for x, y in zip(columns, targets, strict=True):
        if x.shape[:-1] != y.shape:
            raise ShapeError(f"group search: {tuple(x.shape)} against {tuple(y.shape)}")
        if len(y) < 2 * (count + 1):
            raise FitError(
                f"group search: a record has {len(y)} rows for {count} candidates; give longer "
                "drives"
            )
        if not bool(torch.isfinite(x).all() & torch.isfinite(y).all()):
            raise FitError("group search: a row is not finite; leave it out")
    return count


def _noise(gram: Tensor, moment: Tensor, targets: list[Tensor]) -> Tensor:
    """Return the variance that all candidates together leave in each record, shape (D,)."""
    size = gram.diagonal(dim1=-2, dim2=-1).mean(-1)[:, None, None]
    ridge = 1e-9 * torch.where(size > 0.0, size, 1.0)
    solved = torch.linalg.solve(gram + ridge * torch.eye(gram.shape[-1]).to(gram), moment)
    explained = (solved * moment).sum(-1)
    energy = torch.stack([y.square().sum() for y in targets])
    free = torch.tensor([float(len(y) - gram.shape[-1]) for y in targets]).to(gram)
    noise: Tensor = ((energy - explained) / free).clamp(min=1e-300)
    return noise


def _asked(records: int, candidates: int, false_alarm: float) -> float:
    if candidates == 0:
        return float("inf")
    quiet = (1.0 - false_alarm) ** (1.0 / candidates)
    return max(chi_square_quantile(quiet, records), 2.0 * records)


def _best(
    gram: Tensor, moment: Tensor, noise: Tensor, whole: Tensor, left: list[int]
) -> tuple[int, Tensor]:
    energy = gram.diagonal(dim1=-2, dim2=-1)
    fine = energy > COLLINEAR * whole
    taken = torch.where(fine, moment.square() / torch.where(fine, energy, 1.0), 0.0)
    taken = taken / noise.unsqueeze(-1)
    if not left:
        return -1, torch.zeros_like(noise)
    best = left[int(taken[:, left].sum(0).argmax())]
    return best, taken[:, best]


def _eliminated(gram: Tensor, moment: Tensor, whole: Tensor, pivot: int) -> tuple[Tensor, Tensor]:
    """Return Gram matrices and moments of what is orthogonal to a term."""
    column = gram[:, :, pivot]
    energy = column[:, pivot]
    # Records to which the term is nothing new stay: dividing by what rounding left would ruin them.
    fine = energy > COLLINEAR * whole[:, pivot]
    share = column / torch.where(fine, energy, torch.inf).unsqueeze(-1)
    return (
        gram - share.unsqueeze(-1) * column.unsqueeze(-2),
        moment - share * moment[:, pivot : pivot + 1],
    )
