"""How well a filter observed its states over a drive, as it is kept with a run.

The file ``observability.csv`` has a row per time, the first one the start: standard deviations of
all states in SI units, eigenvalues of P' in ascending order, and the eigenvectors of the smallest
and the largest, in initial deviations. P' and P'' follow from it: see
:mod:`navlearn.filters.degree_of_observability`.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import pandas as pd
import torch
from numpy.typing import NDArray
from torch import Tensor

from navlearn.errors import LogError, ShapeError
from navlearn.filters.degree_of_observability import degree_of_observability, normalized_covariance
from navlearn.outages.track import Array

SPACING = 1.0
"""Rows of a record are at least so far apart, s."""


@dataclass(frozen=True, kw_only=True)
class ObservabilityRecord:
    """Degree of observability over a drive; K counts times, n states.

    Attributes:
        names: Of the states.
        t: Times, the start first, s, shape (K,).
        still: Whether the car stood still there, shape (K,).
        sigma: Standard deviation of every state, SI units, shape (K, n).
        eigenvalues: Of P', ascending, shape (K, n).
        best: Eigenvector of the smallest eigenvalue, in initial deviations, shape (K, n).
        least: That of the largest, shape (K, n).
        units: Of the states by name, as far as known.
        known: Names of states that were left out because they were known exactly at the start.
    """

    names: tuple[str, ...]
    t: Array
    still: NDArray[np.bool_]
    sigma: Array
    eigenvalues: Array
    best: Array
    least: Array
    units: Mapping[str, str] = field(default_factory=dict)
    known: tuple[str, ...] = ()

    @property
    def against_start(self) -> Array:
        """Diagonal of P': variance of every state against that at the start, shape (K, n)."""
        ratio: Array = (self.sigma / self.sigma[0]) ** 2
        return ratio

    @property
    def to_share(self) -> Array:
        """What turns P' into P'': n / tr P', shape (K, 1)."""
        factor: Array = len(self.names) / self.eigenvalues.sum(1, keepdims=True)
        return factor

    def row_at(self, time: float) -> int:
        """Return the last row not after a time, or the first.

        Args:
            time: Time, s.
        """
        return max(int(np.searchsorted(self.t, time + 1e-6, side="right")) - 1, 0)

    def row_before(self, time: float) -> int:
        """Return the last row before a time, or the first: of an outage that a fix ends there.

        Args:
            time: Time, s.
        """
        return max(int(np.searchsorted(self.t, time - 1e-6, side="left")) - 1, 0)

    def standstills(self) -> list[tuple[float, float]]:
        """Return from when to when the car stood still, s."""
        steps = np.diff(np.concatenate(([False], self.still, [False])).astype(int))
        starts, stops = np.flatnonzero(steps == 1), np.flatnonzero(steps == -1)
        last = len(self.t) - 1
        return [
            (float(self.t[a]), float(self.t[min(b, last)]))
            for a, b in zip(starts.tolist(), stops.tolist(), strict=True)
        ]


def spoken(name: str) -> str:
    """Return the name of a state as it is read.

    Args:
        name: As in a record.
    """
    return name.replace("_", " ")


def observability_of_run(
    covariance: Tensor,
    start: Tensor,
    t: Tensor,
    *,
    start_time: float,
    names: Sequence[str],
    units: Mapping[str, str] | None = None,
    still: Tensor | None = None,
    spacing: float = SPACING,
) -> ObservabilityRecord:
    """Return the degree of observability over one filter's run, of a RISS or a full IMU.

    Args:
        covariance: P after each update, as ``history.belief.covariance``, shape (K, n, n).
        start: P₀, with which the filter started, shape (n, n).
        t: Time of each covariance, s, not decreasing, shape (K,).
        start_time: Time of P₀, s.
        names: Of the states, n of them.
        units: Of the states by name.
        still: 1.0 where the car stood still, shape (K,); None where that is not known.
        spacing: Times closer than this are thinned, s.

    Returns:
        The record; states whose initial variance is zero are left out of it.

    Raises:
        ShapeError: Shapes do not fit each other.
    """
    n = len(names)
    if covariance.shape != (*t.shape, n, n) or start.shape != (n, n) or t.dim() != 1:
        raise ShapeError(
            f"observability_of_run: found covariances {tuple(covariance.shape)}, start "
            f"{tuple(start.shape)}, times {tuple(t.shape)} and {n} names; expected (K, n, n), "
            "(n, n), (K,) of one drive"
        )
    rows = _rows(t, start_time, spacing)
    unknown = start.diagonal() > 0.0
    states = unknown.nonzero().flatten()
    P0 = start.detach()[states][:, states]
    P = torch.cat((P0.unsqueeze(0), covariance.detach()[rows][:, states][:, :, states]))
    standing = torch.zeros_like(t) if still is None else still.to(t)
    degree = degree_of_observability(normalized_covariance(P, P0))
    return ObservabilityRecord(
        names=tuple(names[i] for i in states.tolist()),
        t=np.concatenate(([start_time], t[rows].numpy())),
        still=np.concatenate((standing[rows[:1]].numpy(), standing[rows].numpy())) > 0.5,
        sigma=P.diagonal(dim1=-2, dim2=-1).clamp(min=0.0).sqrt().numpy(),
        eigenvalues=degree.against_start.numpy(),
        best=degree.directions[..., 0].numpy(),
        least=degree.directions[..., -1].numpy(),
        units=dict(units or {}),
        known=tuple(names[i] for i in (~unknown).nonzero().flatten().tolist()),
    )


def write_observability_csv(path: Path, record: ObservabilityRecord) -> Path:
    """Write a record, to six digits.

    Args:
        path: The file to write.
        record: The record.
    """
    n = len(record.names)
    columns = {
        "t": record.t,
        "still": record.still.astype(int),
        **dict(zip(_named("sigma", record.names), record.sigma.T, strict=True)),
        **dict(zip(_numbered(n), record.eigenvalues.T, strict=True)),
        **dict(zip(_named("best", record.names), record.best.T, strict=True)),
        **dict(zip(_named("least", record.names), record.least.T, strict=True)),
    }
    table = pd.DataFrame(columns)
    table["t"] = table["t"].map("{:.3f}".format)
    table.to_csv(path, index=False, float_format="%.6g", lineterminator="\n")
    return path


def read_observability_csv(
    path: Path, *, units: Mapping[str, str] | None = None
) -> ObservabilityRecord:
    """Return a record that was written before.

    Args:
        path: The file.
        units: Of the states by name, which the file does not tell.

    Raises:
        LogError: The file is not such a record.
    """
    table = pd.read_csv(path)
    columns = [str(name) for name in table.columns]
    names = [name.removeprefix("sigma_") for name in columns if name.startswith("sigma_")]
    wanted = [
        *("t", "still", *_named("sigma", names), *_numbered(len(names))),
        *(*_named("best", names), *_named("least", names)),
    ]
    if columns != wanted or not names or table.empty:
        raise LogError(
            f"{path}: found the columns {columns[:6]} …; expected a record of "
            "observability as a run writes it"
        )

    def part(columns: Sequence[str]) -> Array:
        return table[list(columns)].to_numpy(dtype=np.float64)

    return ObservabilityRecord(
        names=tuple(names),
        t=table["t"].to_numpy(dtype=np.float64),
        still=table["still"].to_numpy() > 0,
        sigma=part(_named("sigma", names)),
        eigenvalues=part(_numbered(len(names))),
        best=part(_named("best", names)),
        least=part(_named("least", names)),
        units=dict(units or {}),
    )


def _named(kind: str, names: Sequence[str]) -> list[str]:
    return [f"{kind}_{name}" for name in names]


def _numbered(count: int) -> list[str]:
    return [f"eigenvalue_{k + 1}" for k in range(count)]


def _rows(t: Tensor, start_time: float, spacing: float) -> Tensor:
    """Return what to keep: of updates at one time the last, and none too close to the one before.

    The last update of all is always kept.
    """
    times = t.tolist()
    last_of_time = [k for k in range(len(times)) if k + 1 == len(times) or times[k + 1] > times[k]]
    kept: list[int] = []
    latest = start_time
    for k in last_of_time:
        if times[k] - latest > spacing - 1e-6 or k + 1 == len(times):
            kept.append(k)
            latest = times[k]
    return torch.tensor(kept, dtype=torch.int64)
