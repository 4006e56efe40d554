"""Search of FOS: at each step the candidate that takes most of the residual.

Source: [Korenberg1989] and [Shen2010] §3. Only the chosen terms are made orthogonal explicitly.
Every other candidate is known by two numbers, its energy outside the chosen terms and its
correlation with the residual, that one table of correlations with the newest direction updates.
A ridge gives each candidate a row of its own below the data, in which no other candidate
stands: it adds to the energies before the search and changes nothing else.
"""

import math
from dataclasses import dataclass

import torch
from torch import Tensor

from navlearn.error_models.fos_candidates import Candidates
from navlearn.error_models.fos_options import FosOptions

Index = tuple[int, int]


def noise_level(rows: float, terms: int, candidates: int, false_alarm: float) -> float:
    """Return the share of white noise that the best of many candidates takes by chance.

    A share ρ² that one candidate takes of ν + 1 degrees of freedom is t²/(ν + t²) with Student's
    t; its quantile is from the normal one by [Wallace1959], the many by Šidák's bound.

    Args:
        rows: Rows that count; with weights, their effective number.
        terms: Terms chosen already.
        candidates: Candidates left.
        false_alarm: Chance that the best exceeds the level.

    Returns:
        A share of the residual's energy, in 0 to 1.
    """
    freedom = rows - terms - 1.0
    if false_alarm >= 1.0:
        return 0.0
    if freedom <= 1.0 or candidates < 1:
        return 1.0
    single = -math.expm1(math.log1p(-false_alarm) / candidates)
    z = -float(torch.special.ndtri(torch.tensor(0.5 * single, dtype=torch.float64)))
    z *= (8.0 * freedom + 3.0) / (8.0 * freedom + 1.0)
    return -math.expm1(-z * z / freedom)


@dataclass
class Search:
    """A search under way.

    Attributes:
        candidates: What is searched.
        target: Weighted target above zeros for the ridge, shape (N + K,).
        options: Rules.
        effective: Rows that count.
        total: Energy of every candidate with its ridge, shape (rows, c).
        energy: Energy outside the chosen terms, shape (rows, c).
        corr: Correlation with the residual, shape (rows, c).
        chosen: Terms, in order.
        basis: Orthonormal directions of the chosen terms, shape (k, N + K).
        upper: Chosen terms in those directions, shape (k, k), upper triangular.
        residual: Shape (N + K,).
        errors: Energy of the residual with the ridge's after each step, the target's first.
        stopped: Why the search ended.
    """

    candidates: Candidates
    target: Tensor
    options: FosOptions
    effective: float
    total: Tensor
    energy: Tensor
    corr: Tensor
    chosen: list[Index]
    basis: Tensor
    upper: Tensor
    residual: Tensor
    errors: list[float]
    stopped: str = ""

    def best(self) -> tuple[Index, float]:
        """Return the candidate of largest reduction, and that reduction."""
        open_to = self.energy > self.options.collinearity * self.total
        gain = torch.where(open_to, self.corr.square() / self.energy, 0.0)
        for index in self.chosen:
            gain[index] = 0.0
        flat, columns = int(gain.argmax()), gain.shape[1]
        return (flat // columns, flat % columns), float(gain.flatten()[flat])

    def level(self, terms: int) -> float:
        """Return the share that white noise reaches beside so many terms."""
        count = int((self.total > 0).sum()) - terms
        return noise_level(self.effective, terms, count, self.options.false_alarm)

    def coefficients(self) -> Tensor:
        """Return the coefficients of the chosen terms in original units, shape (k,)."""
        g = (self.basis @ self.target).unsqueeze(1)
        scaled = torch.linalg.solve_triangular(self.upper, g, upper=True).squeeze(1)
        units = [self.candidates.unit(index) for index in self.chosen]
        return torch.div(scaled, torch.tensor(units, dtype=torch.float64))


def start_search(candidates: Candidates, target: Tensor, options: FosOptions) -> Search:
    """Return the search before its first term.

    Args:
        candidates: What is searched.
        target: Shape (N,), not yet weighted.
        options: Rules.
    """
    weighted = candidates.root_weight * target
    padded = torch.nn.functional.pad(weighted, [0, options.max_terms])
    total = candidates.energies() * (1.0 + options.ridge)
    total[0, 0] /= 1.0 + options.ridge
    weight = candidates.root_weight.square()
    return Search(
        candidates=candidates,
        target=padded,
        options=options,
        effective=float(weight.sum() ** 2 / weight.square().sum()),
        total=total,
        energy=total.clone(),
        corr=candidates.correlations(weighted),
        chosen=[],
        basis=padded.new_zeros(0, padded.shape[0]),
        upper=padded.new_zeros(0, 0),
        residual=padded.clone(),
        errors=[float(padded @ padded)],
    )


def search_forward(search: Search) -> None:
    """Add terms until a rule says stop; ``search.stopped`` tells which."""
    options = search.options
    weight = float(search.candidates.root_weight.square().sum())
    while True:
        error = float(search.residual @ search.residual)
        if math.sqrt(error / weight) <= options.target_error:
            search.stopped = "target error reached"
        elif len(search.chosen) == options.max_terms:
            search.stopped = "largest number of terms"
        else:
            index, reduction = search.best()
            if reduction <= search.level(len(search.chosen)) * error:
                search.stopped = "no candidate above the level of white noise"
            else:
                _choose(search, [*search.chosen, index])
                _move(search, search.basis[-1], -1.0)
                search.errors.append(float(search.residual @ search.residual))
                continue
        return


def exchange_terms(search: Search) -> int:
    """Swap terms for better candidates until none gains; return the number of swaps.

    Without one term, the span lacks one direction: a table of correlations with that direction
    gives the energies and correlations of every candidate beside the other terms.
    """
    swaps = 0
    for _ in range(search.options.exchange_sweeps):
        before = swaps
        for term in tuple(search.chosen):
            place = search.chosen.index(term)
            _move(search, _own_direction(search, place), 1.0)
            old = float(search.corr[term] ** 2 / search.energy[term])
            rest = [other for other in search.chosen if other != term]
            search.chosen = rest
            index, reduction = search.best()
            better = reduction > old * (1.0 + 1e-9)
            _choose(search, [*rest, index if better else term])
            _move(search, search.basis[-1], -1.0)
            swaps += int(better)
        if swaps == before:
            break
    if swaps:
        search.errors.append(float(search.residual @ search.residual))
    return swaps


def search_backward(search: Search) -> int:
    """Drop terms that white noise could stand for, the weakest first; return their number."""
    dropped = 0
    while search.chosen:
        own = [_own_direction(search, k) @ search.target for k in range(len(search.chosen))]
        gains = torch.stack(own).square()
        place = int(gains.argmin())
        error = float(search.residual @ search.residual + gains[place])
        if float(gains[place]) > search.level(len(search.chosen) - 1) * error:
            break
        _move(search, _own_direction(search, place), 1.0)
        _choose(search, [term for k, term in enumerate(search.chosen) if k != place])
        search.errors.append(float(search.residual @ search.residual))
        dropped += 1
    return dropped


def _move(search: Search, direction: Tensor, sign: float) -> None:
    """Take a direction out of every candidate (−1) or give it back (+1)."""
    rows = search.candidates.root_weight.shape[0]
    table = search.candidates.correlations(direction[:rows])
    search.corr.add_(table, alpha=sign * float(direction @ search.target))
    search.energy.addcmul_(table, table, value=sign)


def _choose(search: Search, chosen: list[Index]) -> None:
    """Make the chosen terms orthogonal, in order, and take them out of the target."""
    rows = search.candidates.root_weight.shape[0]
    terms = search.target.new_zeros(search.target.shape[0], len(chosen))
    for k, index in enumerate(chosen):
        terms[:rows, k] = search.candidates.column(index)
        ridge = 0.0 if index == (0, 0) else search.options.ridge
        terms[rows + k, k] = terms[:rows, k].norm() * math.sqrt(ridge)
    basis, search.upper = torch.linalg.qr(terms)
    search.basis = basis.T.contiguous()
    search.residual = search.target - basis @ (search.basis @ search.target)
    search.residual -= basis @ (search.basis @ search.residual)
    search.chosen = chosen


def _own_direction(search: Search, place: int) -> Tensor:
    """Return the unit direction of the span that only one chosen term fills, shape (N + K,)."""
    unit = torch.zeros(len(search.chosen), 1, dtype=torch.float64)
    unit[place] = 1.0
    dual = torch.linalg.solve_triangular(search.upper.T, unit, upper=False).squeeze(1)
    direction = dual @ search.basis
    return torch.div(direction, direction.norm())
