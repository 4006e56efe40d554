"""Search of FOS: at each step the candidate that takes most of the residual.

Source: [Korenberg1989] and [Shen2010] §3. The orthogonal functions are never formed: a candidate
is known by its energy outside the chosen terms and its correlation with the residual, and both
follow from the rows of the Gram matrix that belong to chosen terms. So what is searched, one
window, many, or sums that slide, only has to give such rows. A ridge gives each candidate a row
of its own below the data, in which no other candidate stands: it adds to the energies before the
search and changes nothing else. All tensors have the windows first: one search for each of B
windows, side by side.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace

import torch
from torch import Tensor

from navlearn.error_models.fos_level import accepted_share
from navlearn.error_models.fos_options import FosOptions

ENOUGH = "target error reached"
FULL = "largest number of terms"
NOISE = "no candidate above the level of white noise"

MOVING = ("energy", "corr", "error", "chosen", "used", "gram")
"""What adding and dropping terms changes in a search."""


@dataclass
class Search:
    """A search under way in each of B windows, over M candidates, with K places for terms.

    Attributes:
        options: Rules.
        gram_rows: Gives the Gram matrix's row of one candidate of each window, shape (B, M).
        total: Energy of every candidate with its ridge, shape (B, M).
        cross: Correlation of every candidate with the target, shape (B, M).
        weight: Sum of the weights, shape (B,).
        effective: Rows that count, per window.
        sizes: Candidates that are not zero throughout, per window.
        energy: Energy outside the chosen terms, shape (B, M).
        corr: Correlation with the residual, shape (B, M).
        error: Energy of the residual with the ridge's, shape (B,).
        chosen: Terms, shape (B, K).
        used: Which places hold a term, shape (B, K).
        gram: Rows of the Gram matrix of the chosen terms, shape (B, K, M).
        errors: Residual's energy after each step, the target's first, per window.
        stopped: Why each search ended.
    """

    options: FosOptions
    gram_rows: Callable[[Tensor], Tensor]
    total: Tensor
    cross: Tensor
    weight: Tensor
    effective: list[float]
    sizes: list[int]
    energy: Tensor
    corr: Tensor
    error: Tensor
    chosen: Tensor
    used: Tensor
    gram: Tensor
    errors: list[list[float]]
    stopped: list[str]

    def best(self) -> tuple[Tensor, Tensor]:
        """Return the candidate of largest reduction and that reduction, shape (B,) each."""
        open_to = self.energy > self.options.collinearity * self.total
        gain = torch.where(open_to, self.corr.square() / self.energy, 0.0)
        window, place = torch.nonzero(self.used, as_tuple=True)
        gain[window, self.chosen[window, place]] = 0.0
        index = gain.argmax(1)
        return index, gain.gather(1, index.unsqueeze(1)).squeeze(1)

    def levels(self, terms: Tensor) -> Tensor:
        """Return the share that a candidate must take beside so many terms, shape (B,)."""
        shares = [
            accepted_share(rows, used, size - used, self.options)
            for rows, used, size in zip(self.effective, terms.tolist(), self.sizes, strict=True)
        ]
        return torch.tensor(shares, dtype=torch.float64)

    def add(self, place: int, index: Tensor, row: Tensor, windows: Tensor) -> None:
        """Choose a candidate of each window of a mask, to stand at an empty place.

        Args:
            place: Where.
            index: Candidates, shape (B,).
            row: Their rows of the Gram matrix, shape (B, M).
            windows: Mask, shape (B,).
        """
        at = index.unsqueeze(1)
        beside = torch.where(self.used, row.gather(1, self.chosen), 0.0).unsqueeze(2)
        within = torch.cholesky_solve(beside, self.factor()).squeeze(2)
        norm = torch.where(windows.unsqueeze(1), self.energy.gather(1, at), torch.inf).sqrt()
        self._move((row - self._mix(within)) / norm, self.corr.gather(1, at) / norm, -1.0)
        hit = torch.nonzero(windows).squeeze(1)
        self.gram[hit, place], self.chosen[hit, place] = row[hit], index[hit]
        self.used[hit, place] = True

    def drop(self, place: Tensor, windows: Tensor) -> None:
        """Give up the term at a place of each window of a mask.

        Args:
            place: Where, shape (B,).
            windows: Mask, shape (B,).
        """
        at = place.reshape(-1, 1, 1).expand(-1, self.used.shape[1], 1)
        dual = torch.cholesky_inverse(self.factor()).gather(2, at).squeeze(2)
        own = dual.gather(1, place.unsqueeze(1))
        dual = torch.where(windows.unsqueeze(1), dual / own.sqrt(), 0.0)
        self._move(self._mix(dual), (dual * self.own_cross()).sum(1, keepdim=True), 1.0)
        hit = torch.nonzero(windows).squeeze(1)
        self.used[hit, place[hit]] = False

    def copy_state(self) -> "Search":
        """Return a search that stands where this one does."""
        return replace(self, **{name: getattr(self, name).clone() for name in MOVING})

    def put_back(self, other: "Search", windows: Tensor) -> None:
        """Return the windows of a mask to where another search stands."""
        for name in MOVING:
            mine, its = getattr(self, name), getattr(other, name)
            mask = windows.reshape(-1, *[1] * (mine.ndim - 1))
            setattr(self, name, torch.where(mask, its, mine))

    def factor(self) -> Tensor:
        """Return the Cholesky factor of the terms' Gram matrix, ones elsewhere, (B, K, K)."""
        columns = self.chosen.unsqueeze(1).expand(-1, self.chosen.shape[1], -1)
        both = self.used.unsqueeze(1) & self.used.unsqueeze(2)
        small = torch.where(both, self.gram.gather(2, columns), 0.0)
        ridge = self.options.ridge * (self.chosen != 0).double()
        own = torch.where(self.used, small.diagonal(dim1=1, dim2=2) * ridge, 1.0)
        lower: Tensor = torch.linalg.cholesky(small + torch.diag_embed(own))
        return lower

    def own_cross(self) -> Tensor:
        """Return the correlation of the terms with the target, zero where none is, (B, K)."""
        return torch.where(self.used, self.cross.gather(1, self.chosen), 0.0)

    def note_errors(self, windows: Tensor) -> None:
        """Note the residual's energy of the windows of a mask, shape (B,)."""
        noted = zip(self.errors, windows.tolist(), self.error.tolist(), strict=True)
        for errors, moved, error in noted:
            if moved:
                errors.append(error)

    def _mix(self, share: Tensor) -> Tensor:
        """Return the sum over terms of a number (B, K) times the Gram matrix's row, (B, M)."""
        return torch.matmul(share.unsqueeze(1), self.gram).squeeze(1)

    def _move(self, part: Tensor, share: Tensor, sign: float) -> None:
        """Take a direction out of every candidate (−1) or give it back (+1).

        Args:
            part: Every candidate's part along it, shape (B, M).
            share: The target's, shape (B, 1).
            sign: Which.
        """
        self.energy.addcmul_(part, part, value=sign)
        self.corr.addcmul_(share, part, value=sign)
        self.error = self.error + sign * share.squeeze(1).square()


def start_search(
    gram_rows: Callable[[Tensor], Tensor],
    energies: Tensor,
    cross: Tensor,
    square: Tensor,
    weight: Tensor,
    options: FosOptions,
) -> Search:
    """Return the search before its first term.

    Args:
        gram_rows: Gives the Gram matrix's row of one candidate of each window, shape (B, M).
        energies: Energy of every candidate on the data, shape (B, M).
        cross: Correlation of every candidate with the target, shape (B, M).
        square: Energy of the target, shape (B,).
        weight: Weight of each row, shape (B, N).
        options: Rules.
    """
    windows, candidates = energies.shape
    total = energies * (1.0 + options.ridge)
    total[:, 0] = energies[:, 0]
    chosen = torch.zeros(windows, options.max_terms, dtype=torch.long)
    return Search(
        options=options,
        gram_rows=gram_rows,
        total=total,
        cross=cross,
        weight=weight.sum(1),
        effective=(weight.sum(1).square() / weight.square().sum(1)).tolist(),
        sizes=(total > 0).sum(1).tolist(),
        energy=total.clone(),
        corr=cross.clone(),
        error=square.clone(),
        chosen=chosen,
        used=torch.zeros_like(chosen, dtype=torch.bool),
        gram=energies.new_zeros(windows, options.max_terms, candidates),
        errors=[[value] for value in square.tolist()],
        stopped=[""] * windows,
    )


def search_forward(search: Search) -> None:
    """Add terms until a rule says stop; ``search.stopped`` tells which."""
    options = search.options
    going = torch.ones_like(search.error, dtype=torch.bool)
    for place in range(options.max_terms + 1):
        index, reduction = search.best()
        count = search.used.sum(1)
        enough = (search.error.clamp(min=0.0) / search.weight).sqrt() <= options.target_error
        full = count == options.max_terms
        noise = reduction <= search.levels(count) * search.error
        ends = going & (enough | full | noise)
        if bool(ends.any()):
            for reason, holds in ((NOISE, noise), (FULL, full), (ENOUGH, enough)):
                for window in torch.nonzero(ends & holds).flatten().tolist():
                    search.stopped[window] = reason
            going = going & ~ends
            if not bool(going.any()):
                return
        search.add(place, index, search.gram_rows(index), going)
        search.note_errors(going)
