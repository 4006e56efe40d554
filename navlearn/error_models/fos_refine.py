"""What FOS does after its search: exchange terms for better ones, drop weak ones, try elsewhere.

The search never looks back. Where candidates are strongly correlated, its first terms stand in
for several true ones; swapping each for the best candidate beside the others, until no swap gains,
mends that; a kick leads on from where no single swap gains. All windows are refined side by side.
"""

import torch
from torch import Tensor

from navlearn.error_models.fos_state import Search

KICKED = 3
"""Terms that a kick drops."""


def exchange_terms(search: Search) -> Tensor:
    """Swap terms for better candidates until none gains; return the swaps of each window, (B,)."""
    swaps = _sweep(search)
    search.note_errors(swaps > 0)
    return swaps


def kick_terms(search: Search) -> Tensor:
    """Drop some terms at random, search and exchange again; return the kicks that gained, (B,)."""
    generator = torch.Generator().manual_seed(search.options.seed)
    gained = torch.zeros_like(search.count)
    for _ in range(search.options.kicks):
        before = search.copy_state()
        for draw in torch.rand(KICKED, generator=generator, dtype=torch.float64):
            search.drop((draw * search.count).long(), search.count > 0)
        for _ in range(KICKED):
            index, reduction = search.best()
            missing = (search.count < before.count) & (reduction > 0.0)
            search.add(index, search.gram_rows(index), missing)
        _sweep(search)
        better = search.error < before.error * (1.0 - 1e-9)
        search.put_back(before, ~better)
        search.note_errors(better)
        gained += better.long()
    return gained


def search_backward(search: Search) -> Tensor:
    """Drop terms that the rule would not accept, the weakest first; return their number, (B,)."""
    dropped = torch.zeros_like(search.count)
    while True:
        gain, place = _own_gains(search).min(1)
        level = search.levels((search.count - 1).clamp(min=0))
        weak = (search.count > 0) & (gain <= level * (search.error + gain))
        if not bool(weak.any()):
            return dropped
        search.drop(place, weak)
        search.note_errors(weak)
        dropped += weak.long()


def _sweep(search: Search) -> Tensor:
    """Exchange every term, sweep after sweep; return the swaps of each window, shape (B,)."""
    swaps = torch.zeros_like(search.count)
    going = search.count > 0
    for _ in range(search.options.exchange_sweeps):
        before = swaps.clone()
        turns = torch.where(going, search.count, 0)
        for turn in range(int(turns.max())):
            swaps += _exchange(search, turns > turn).long()
        going = swaps > before
        if not bool(going.any()):
            break
    return swaps


def _exchange(search: Search, windows: Tensor) -> Tensor:
    """Put the best candidate for the first term at the end; return where it is another one."""
    term = search.drop(torch.zeros_like(search.count), windows)
    index, reduction = search.best()
    better = windows & (reduction > term.share.square() * (1.0 + 1e-9))
    search.put(term, windows & ~better)
    if bool(better.any()):
        search.add(index, search.gram_rows(index), better)
    return better


def _own_gains(search: Search) -> Tensor:
    """Return what each term takes beside all others; infinite where none is, shape (B, K)."""
    unit = torch.eye(search.upper.shape[1], dtype=torch.float64).expand_as(search.upper)
    dual = torch.linalg.solve_triangular(search.upper, unit, upper=True)
    share = torch.matmul(dual, search.share.unsqueeze(2)).squeeze(2)
    return torch.where(search.used(), share.square() / dual.square().sum(2), torch.inf)
