"""What FOS does after its search: exchange terms for better ones, drop weak ones, try elsewhere.

The search never looks back. Where candidates are strongly correlated, its first terms stand in
for several true ones; swapping each for the best candidate beside the others, until no swap gains,
mends that; a kick leads on from where no single swap gains. All windows are refined side by side.
"""

import torch
from torch import Tensor

from navlearn.error_models.fos_search import Search

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
    slots = search.chosen.shape[1]
    gained = torch.zeros_like(search.chosen[:, 0])
    for _ in range(search.options.kicks):
        before = search.copy_state()
        places = torch.randperm(slots, generator=generator)[:KICKED].tolist()
        dropped = search.used[:, places]
        for place, windows in zip(places, dropped.unbind(1), strict=True):
            search.drop(torch.full_like(gained, place), windows)
        for place, windows in zip(places, dropped.unbind(1), strict=True):
            index, reduction = search.best()
            search.add(place, index, search.gram_rows(index), windows & (reduction > 0.0))
        _sweep(search)
        better = search.error < before.error * (1.0 - 1e-9)
        search.put_back(before, ~better)
        search.note_errors(better)
        gained += better.long()
    return gained


def search_backward(search: Search) -> Tensor:
    """Drop terms that the rule would not accept, the weakest first; return their number, (B,)."""
    dropped = torch.zeros_like(search.chosen[:, 0])
    while True:
        gain, place = _own_gains(search).min(1)
        count = search.used.sum(1)
        error = search.error + gain
        weak = (count > 0) & (gain <= search.levels((count - 1).clamp(min=0)) * error)
        if not bool(weak.any()):
            return dropped
        search.drop(place, weak)
        search.note_errors(weak)
        dropped += weak.long()


def _sweep(search: Search) -> Tensor:
    """Exchange every term, sweep after sweep; return the swaps of each window, shape (B,)."""
    swaps = torch.zeros_like(search.chosen[:, 0])
    going = torch.ones_like(swaps, dtype=torch.bool)
    for _ in range(search.options.exchange_sweeps):
        before = swaps.clone()
        for place in range(search.chosen.shape[1]):
            turn = going & search.used[:, place]
            if bool(turn.any()):
                swaps += _exchange(search, place, turn).long()
        going = swaps > before
        if not bool(going.any()):
            break
    return swaps


def _exchange(search: Search, place: int, windows: Tensor) -> Tensor:
    """Put the best candidate beside the others at a place; return where it is another one."""
    term, row = search.chosen[:, place].clone(), search.gram[:, place].clone()
    search.drop(torch.full_like(term, place), windows)
    index, reduction = search.best()
    at = term.unsqueeze(1)
    own = (search.corr.gather(1, at).square() / search.energy.gather(1, at)).squeeze(1)
    better = windows & (reduction > own * (1.0 + 1e-9))
    if bool(better.any()):
        term = torch.where(better, index, term)
        row = torch.where(better.unsqueeze(1), search.gram_rows(term), row)
    search.add(place, term, row, windows)
    return better


def _own_gains(search: Search) -> Tensor:
    """Return what each term takes beside all others; infinite where none is, shape (B, K)."""
    dual = torch.cholesky_inverse(search.factor())
    share = (dual @ search.own_cross().unsqueeze(2)).squeeze(2)
    gains = share.square() / dual.diagonal(dim1=1, dim2=2)
    return torch.where(search.used, gains, torch.inf)
