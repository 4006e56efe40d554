"""Where a search of FOS stands: terms, their directions, and what is left for every candidate.

Source: [Korenberg1989]. A direction is known by what it takes of each candidate, not by its rows:
a term enters by the recursion of D(m, r) and leaves by rotations, as a column leaves a QR
factorisation, so that collinear terms do not spoil what stays. A ridge gives each candidate a row
of its own below the data, in which no other candidate stands: it adds to the energies before the
search and changes nothing else.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import NamedTuple

import torch
from torch import Tensor

from navlearn.error_models.fos_level import accepted_share
from navlearn.error_models.fos_options import FosOptions

MOVING = ("energy", "corr", "error", "chosen", "count", "part", "share", "upper")
"""What adding and dropping terms changes in a search."""


class Term(NamedTuple):
    """A term of each window, and the direction that it adds to the others.

    Attributes:
        candidate: Which it is, shape (B,).
        part: Every candidate's part along the direction, shape (B, M).
        share: The target's, shape (B,).
        column: The term in the directions before it and, last, its own, shape (B, K).
    """

    candidate: Tensor
    part: Tensor
    share: Tensor
    column: Tensor


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
        chosen: Terms in order, zeros behind them, shape (B, K).
        count: Number of terms, shape (B,).
        part: Every candidate's part along the direction of each term, shape (B, K, M).
        share: The target's part along them, shape (B, K).
        upper: The terms in those directions, ones behind them, shape (B, K, K).
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
    count: Tensor
    part: Tensor
    share: Tensor
    upper: Tensor
    errors: list[list[float]]
    stopped: list[str]

    def best(self) -> tuple[Tensor, Tensor]:
        """Return the candidate of largest reduction and that reduction, shape (B,) each."""
        apart = self.energy > self.options.collinearity * self.total
        gain = torch.where(apart, self.corr.square() / self.energy, 0.0)
        window, place = torch.nonzero(self.used(), as_tuple=True)
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

    def used(self) -> Tensor:
        """Return which places hold a term, shape (B, K)."""
        return torch.arange(self.chosen.shape[1]) < self.count.unsqueeze(1)

    def add(self, index: Tensor, row: Tensor, windows: Tensor) -> None:
        """Choose one more candidate of each window of a mask.

        Args:
            index: Candidates, shape (B,).
            row: Their rows of the Gram matrix, shape (B, M).
            windows: Mask, shape (B,).
        """
        at = index.unsqueeze(1)
        norm = torch.where(windows.unsqueeze(1), self.energy.gather(1, at), torch.inf).sqrt()
        along = self.part.gather(2, at.unsqueeze(1).expand(*self.chosen.shape, 1))
        part = (row - torch.matmul(along.mT, self.part).squeeze(1)) / norm
        share = (self.corr.gather(1, at) / norm).squeeze(1)
        own = torch.arange(along.shape[1]) == self.count.unsqueeze(1)
        self.put(Term(index, part, share, torch.where(own, norm, along.squeeze(2))), windows)

    def put(self, term: Term, windows: Tensor) -> None:
        """Append a term whose direction is known to the windows of a mask."""
        hit = torch.nonzero(windows).squeeze(1)
        place = self.count[hit]
        self.chosen[hit, place], self.part[hit, place] = term.candidate[hit], term.part[hit]
        self.share[hit, place], self.upper[hit, :, place] = term.share[hit], term.column[hit]
        self.count = self.count + windows.long()
        self._move(term, windows, -1.0)

    def drop(self, place: Tensor, windows: Tensor) -> Term:
        """Give up the term at a place of each window of a mask; return it as if chosen last.

        Args:
            place: Where, shape (B,).
            windows: Mask, shape (B,).
        """
        slots = torch.arange(self.chosen.shape[1])
        last = (self.count - 1).clamp(min=0).unsqueeze(1)
        shifted = slots + (slots >= place.unsqueeze(1)).long()
        order = torch.where(
            slots == last, place.unsqueeze(1), torch.where(slots < last, shifted, slots)
        )
        order = torch.where(windows.unsqueeze(1), order, slots)
        moved = self.upper.gather(2, order.unsqueeze(1).expand_as(self.upper))
        turn, self.upper = torch.linalg.qr(moved)
        self.part = torch.matmul(turn.mT, self.part)
        self.share = torch.matmul(turn.mT, self.share.unsqueeze(2)).squeeze(2)
        self.chosen = self.chosen.gather(1, order)
        every, end = torch.arange(place.shape[0]), last.squeeze(1)
        term = Term(
            self.chosen[every, end],
            self.part[every, end],
            self.share[every, end],
            self.upper[every, :, end],
        )
        hit = torch.nonzero(windows).squeeze(1)
        self.chosen[hit, end[hit]] = 0
        self.part[hit, end[hit]] = 0.0
        self.share[hit, end[hit]] = 0.0
        self.upper[hit, :, end[hit]] = torch.eye(slots.shape[0], dtype=torch.float64)[end[hit]]
        self.count = self.count - windows.long()
        self._move(term, windows, 1.0)
        return term

    def copy_state(self) -> "Search":
        """Return a search that stands where this one does."""
        return replace(self, **{name: getattr(self, name).clone() for name in MOVING})

    def put_back(self, other: "Search", windows: Tensor) -> None:
        """Return the windows of a mask to where another search stands."""
        for name in MOVING:
            mine, its = getattr(self, name), getattr(other, name)
            mask = windows.reshape(-1, *[1] * (mine.ndim - 1))
            setattr(self, name, torch.where(mask, its, mine))

    def note_errors(self, windows: Tensor) -> None:
        """Note the residual's energy of the windows of a mask, shape (B,)."""
        noted = zip(self.errors, windows.tolist(), self.error.tolist(), strict=True)
        for errors, moved, error in noted:
            if moved:
                errors.append(error)

    def _move(self, term: Term, windows: Tensor, sign: float) -> None:
        """Take a direction out of every candidate (−1) or give it back (+1)."""
        part = torch.where(windows.unsqueeze(1), term.part, 0.0)
        share = torch.where(windows, term.share, 0.0)
        self.energy.addcmul_(part, part, value=sign)
        self.corr.addcmul_(share.unsqueeze(1), part, value=sign)
        self.error = self.error + sign * share.square()
