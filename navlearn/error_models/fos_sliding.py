"""FOS in a window that slides while driving: rows go in one by one, a fit is there when asked for.

A fit equals ``fit_fos`` on the last rows, terms, coefficients and record; the sums behind its
search are carried from fit to fit, so it costs what the rows in between cost. Coefficients come
from the window itself, not from the carried sums.
"""

import torch
from torch import Tensor

from navlearn.error_models.base import FittedErrorModel, TrainingSource
from navlearn.error_models.fos_candidates import Candidates, factor_list
from navlearn.error_models.fos_fit import check_weight, equations, finish_search
from navlearn.error_models.fos_options import FosOptions
from navlearn.error_models.fos_outcome import build_fitted, read_outcomes
from navlearn.error_models.fos_search import start_search
from navlearn.error_models.fos_sums import SlidingSums
from navlearn.errors import ConfigError, FitError, ShapeError


class SlidingFos:
    """The last rows of a stream, and a model of them whenever it is asked for.

    Args:
        inputs: Number of inputs m.
        window: Rows of the window, more than the lags.
        options: What is searched and when it stops.
        source: What the caller knows about the data, for the records.

    Raises:
        ConfigError: The window is no longer than the lags.
    """

    def __init__(
        self,
        inputs: int,
        window: int,
        options: FosOptions | None = None,
        source: TrainingSource | None = None,
    ) -> None:
        self.options = options or FosOptions()
        self.source = source or TrainingSource()
        self.window = window
        self.memory = max(self.options.lags, self.options.output_lags)
        if window <= self.memory:
            raise ConfigError(
                f"fos: a window of {window} rows is too short for {self.memory} lags; give more"
            )
        # Columns of both: inputs, target, weight of each row; lagged columns, target, weight of
        # each equation. The last of them are in use; what is before them left the window.
        self._rows = torch.zeros(inputs + 2, 4 * window, dtype=torch.float64)
        columns = len(factor_list(inputs, self.options))
        self._equations = torch.zeros(columns + 2, 4 * window, dtype=torch.float64)
        self._base = 0
        self._end = 0
        self._summed = (0, 0)
        self._sums: SlidingSums | None = None

    def __len__(self) -> int:
        """Rows in the window."""
        return min(self._end, self.window)

    def push(self, u: Tensor, y: Tensor, weight: Tensor | None = None) -> None:
        """Take the next rows; the oldest leave the window.

        After a gap in the stream, give the first ``memory`` rows weight zero: their past is not
        the rows before them.

        Args:
            u: Inputs, shape (R, m).
            y: Target, shape (R, 1).
            weight: Weight of each row, not negative, shape (R,); None for equal weights.

        Raises:
            ShapeError: The shapes do not belong together.
        """
        weight = check_weight(y, weight)
        if u.shape != (y.shape[0], self._rows.shape[0] - 2) or y.ndim != 2:
            raise ShapeError(
                f"fos: inputs have shape {tuple(u.shape)} and the target {tuple(y.shape)}; "
                f"expected (R, {self._rows.shape[0] - 2}) and (R, 1)"
            )
        rows = torch.cat([u.double(), y.double(), weight.unsqueeze(1)], 1).mT
        for part in torch.split(rows, self.window, 1):
            self._make_room(part.shape[1])
            self._rows[:, self._end - self._base :][:, : part.shape[1]] = part
            self._end += part.shape[1]

    @torch.no_grad()
    def fit(self) -> FittedErrorModel:
        """Return the model of the window; equals ``fit_fos`` on its rows.

        Raises:
            ShapeError: There are no more rows than lags.
            FitError: No row counts, or a row that counts is not finite or reaches one that is not.
        """
        first = self._end - len(self)
        if len(self) <= self.memory:
            raise ShapeError(f"fos: {len(self)} rows are too few for {self.memory} lags; push more")
        begin = first + self.memory
        self._build_equations(max(begin, self._summed[1]))
        now = self._slice(begin, self._end)
        candidates, target = self._candidates(now), now[-2].unsqueeze(0)
        if not bool((candidates.weight > 0).any()):
            raise FitError("fos: no row with a whole past has a positive weight; push more rows")
        sums = self._carry(begin, candidates, target)
        search = start_search(
            sums.gram_rows,
            sums.energies.unsqueeze(0),
            sums.cross.unsqueeze(0),
            (candidates.weight * target.square()).sum(1),
            candidates.weight,
            self.options,
        )
        finish_search(search)
        found = read_outcomes(search, candidates, target)[0]
        rows = self._rows[:, first - self._base : self._end - self._base]
        u, y, weight = rows[:-2].mT, rows[-2].unsqueeze(1), rows[-1]
        return build_fitted(found, u, y, weight, self.options, self.source)

    def _carry(self, begin: int, candidates: Candidates, target: Tensor) -> SlidingSums:
        """Return the sums of the equations from a row on; those of no weight change nothing."""
        left, entered = (self._summed[0], begin), (self._summed[1], self._end)
        changed = left[1] - left[0] + entered[1] - entered[0]
        self._summed = (begin, self._end)
        if self._sums is None:
            self._sums = SlidingSums(candidates, target, keep=2 * self.options.max_terms)
        elif begin > entered[0] or changed >= self._end - begin:
            self._sums.anchor(candidates, target)
        else:
            rows = torch.cat([self._slice(*entered), self._slice(*left)], 1)
            rows[-1, entered[1] - entered[0] :] *= -1.0
            moved = self._candidates(rows)
            self._sums.slide(candidates, target, moved, rows[-2].unsqueeze(0))
        return self._sums

    def _build_equations(self, start: int) -> None:
        """Build the equations of the rows from one on, each with the rows before it."""
        rows = self._rows[:, start - self.memory - self._base : self._end - self._base]
        weight = rows[-1].clone()
        weight[: self.memory] = 0.0
        if start < self._end and bool((weight > 0).any()):
            x, target, share = equations(
                rows[:-2].mT, rows[-2].unsqueeze(1), weight, self.options, alone=True
            )
            self._slice(start, self._end).copy_(torch.cat([x, target[None], share[None]]))
        elif start < self._end:
            self._slice(start, self._end).zero_()

    def _candidates(self, equations: Tensor) -> Candidates:
        """Return the candidates over some equations, B = 1."""
        return Candidates(equations[:-2].unsqueeze(0), equations[-1:], self.options.degree)

    def _slice(self, start: int, stop: int) -> Tensor:
        """Return the equations from one row to another."""
        return self._equations[:, start - self._base : stop - self._base]

    def _make_room(self, rows: int) -> None:
        """Move what is still needed to the front if so many rows would not fit."""
        if self._end + rows - self._base <= self._rows.shape[1]:
            return
        keep = 2 * self.window
        if self._end - self._summed[0] > keep:
            self._sums = None
        start = self._end - keep
        for buffer in (self._rows, self._equations):
            buffer[:, :keep] = buffer[:, start - self._base :][:, :keep].clone()
        self._base = start
