"""What is kept of windows while parallel cascades are built on them."""

from dataclasses import dataclass, field
from typing import NamedTuple

from torch import Tensor

from navlearn.error_models.pci_candidates import Cascades


class Rows(NamedTuple):
    """Rows of B windows, standardised; rows that do not count are zero.

    Attributes:
        lagged: Lagged inputs by lag, then channel, shape (B, N, L).
        target: Outputs times ``root``, shape (B, N).
        root: Root of the weight of each row, of squared sum 1, shape (B, N).
        rows: Effective number of rows by their weights, shape (B,).
    """

    lagged: Tensor
    target: Tensor
    root: Tensor
    rows: Tensor


@dataclass(kw_only=True)
class Built:
    """The model of one window as it grows.

    Attributes:
        accepted: Cascades, one after the other, each with axes (1, ...).
        curve: Mean squared residual, before the first and after each.
        tried: Candidates tried.
        missed: Batches in a row of which none passed.
        stopped: Why it ended; empty while it goes on.
        polished: Responses after the last polishing, shape (K, L); None without.
    """

    accepted: list[Cascades] = field(default_factory=list)
    curve: list[float] = field(default_factory=list)
    tried: int = 0
    missed: int = 0
    stopped: str = ""
    polished: Tensor | None = None


@dataclass(kw_only=True)
class Live:
    """What is kept of the windows that go on, B of them.

    Attributes:
        windows: Their places among all windows, shape (B,).
        rows: Their rows.
        residual: What is left to explain, times the root of the weights, shape (B, N).
        spanned: Orthonormal columns of all polynomials so far, or zeros, shape (B, N, r).
        correlations: Autocorrelations of their inputs, shape (B, J, m).
        response: Responses of all cascades so far, zeros for none, shape (B, K, L).
    """

    windows: Tensor
    rows: Rows
    residual: Tensor
    spanned: Tensor
    correlations: Tensor
    response: Tensor
