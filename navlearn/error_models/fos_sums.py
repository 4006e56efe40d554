"""The sums that FOS searches, carried along with a sliding window.

Rows that enter are added, rows that leave are taken off: the work follows the rows that changed,
not the window. Carried are the energies, the correlations with the target, and the rows of the
Gram matrix that recent searches asked for; memory grows with the candidates, never with their
square. Taking off leaves the rounding errors of what was there, so the sums are built anew once
the window has turned over, and at once when something has shrunk so far that those would show.
"""

from collections import OrderedDict

import torch
from torch import Tensor

from navlearn.error_models.fos_candidates import Candidates, sum_products

SHRUNK = 1e-6
"""Share of its highest energy below which a channel's rounding errors would show."""


class SlidingSums:
    """Energies, correlations and some rows of the Gram matrix of one window.

    Args:
        window: Columns and weights of the window, B = 1.
        target: Shape (1, N).
        keep: Most rows of the Gram matrix that are carried.
    """

    def __init__(self, window: Candidates, target: Tensor, keep: int) -> None:
        self.keep = keep
        self.rows: OrderedDict[int, Tensor] = OrderedDict()
        self.anchor(window, target)

    def anchor(self, window: Candidates, target: Tensor) -> None:
        """Build the sums anew.

        Args:
            window: Columns and weights of the window, B = 1.
            target: Shape (1, N).
        """
        self.energies = window.energies()[0]
        self.cross = window.correlations(target)[0]
        self.highest = torch.cat([self.energies, _energy(window, target)])
        self.rows.clear()
        self.window = window
        self.slid = 0

    def slide(
        self, window: Candidates, target: Tensor, changed: Candidates, changed_target: Tensor
    ) -> None:
        """Add the rows that entered and take off those that left.

        Args:
            window: Columns and weights of the window as it is now, B = 1.
            target: Shape (1, N).
            changed: Rows that entered, and with negative weight those that left, B = 1.
            changed_target: Shape (1, R).
        """
        products = [changed_target[0]]
        if self.rows:
            products += changed.columns(torch.tensor([list(self.rows)]))[0].unbind(0)
        x, weight = changed.x[0], changed.weight[0]
        sums = sum_products(x, weight * torch.stack(products), window.degree)
        self.energies += sum_products(x.square(), weight, window.degree)
        self.cross += sums[0]
        for row, change in zip(self.rows.values(), sums[1:], strict=True):
            row += change
        self.window = window
        self.slid += changed.weight.shape[-1]
        now = torch.cat([self.energies, _energy(window, target)])
        self.highest = torch.maximum(self.highest, now)
        shrunk = (now < SHRUNK * self.highest).any()
        if self.slid >= 2 * window.weight.shape[-1] or bool(shrunk):
            self.anchor(window, target)

    def gram_rows(self, index: Tensor) -> Tensor:
        """Return the Gram matrix's row of a candidate, shape (1, M); carried from then on.

        Args:
            index: Shape (1,).
        """
        place = int(index)
        if place not in self.rows:
            self.rows[place] = self.window.gram_rows(index)[0]
            if len(self.rows) > self.keep:
                self.rows.popitem(last=False)
        self.rows.move_to_end(place)
        return self.rows[place].unsqueeze(0)


def _energy(window: Candidates, target: Tensor) -> Tensor:
    """Return the energy of the target, shape (1,)."""
    return (window.weight * target.square()).sum(1)
