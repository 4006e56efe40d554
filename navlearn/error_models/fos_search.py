"""Search of FOS: at each step the candidate that takes most of the residual.

Source: [Korenberg1989] and [Shen2010] §3. The orthogonal functions are never formed: a candidate
is known by its energy outside the chosen terms and its correlation with the residual, and both
follow from the rows of the Gram matrix that belong to chosen terms. So what is searched, one
window, many, or sums that slide, only has to give such rows. All tensors have the windows first:
one search for each of B windows, side by side.
"""

from collections.abc import Callable

import torch
from torch import Tensor

from navlearn.error_models.fos_options import FosOptions
from navlearn.error_models.fos_state import Search

ENOUGH = "target error reached"
FULL = "largest number of terms"
NOISE = "no candidate above the level of white noise"


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
        count=chosen[:, 0].clone(),
        part=energies.new_zeros(windows, options.max_terms, candidates),
        share=energies.new_zeros(windows, options.max_terms),
        upper=torch.eye(options.max_terms, dtype=torch.float64).repeat(windows, 1, 1),
        errors=[[value] for value in square.tolist()],
        stopped=[""] * windows,
    )


def search_forward(search: Search) -> None:
    """Add terms until a rule says stop; ``search.stopped`` tells which."""
    options = search.options
    going = torch.ones_like(search.error, dtype=torch.bool)
    while True:
        index, reduction = search.best()
        enough = (search.error.clamp(min=0.0) / search.weight).sqrt() <= options.target_error
        full = search.count == options.max_terms
        noise = reduction <= search.levels(search.count) * search.error
        ends = going & (enough | full | noise)
        if bool(ends.any()):
            for reason, holds in ((NOISE, noise), (FULL, full), (ENOUGH, enough)):
                for window in torch.nonzero(ends & holds).flatten().tolist():
                    search.stopped[window] = reason
            going = going & ~ends
            if not bool(going.any()):
                return
        search.add(index, search.gram_rows(index), going)
        search.note_errors(going)
