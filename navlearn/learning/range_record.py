"""What a tightly coupled filter made of every range that it was given, satellite by satellite.

The raw material of range-error models. What remains of a range after the update is seen relative
to the receiver's clock and to the position, which have taken their share of every satellite's
error: an error common to all satellites is clock, and one that varies with direction is partly
position. A single satellite's error is therefore never seen itself. What is seen is where the
satellite disagrees with the solution of all, and that is what a solution from few of them needs:
ranges less their residuals give any subset of satellites the solution of the whole.
"""

from typing import NamedTuple

import torch
from torch import Tensor

from navlearn.errors import ShapeError
from navlearn.fusion.measurements import believed
from navlearn.fusion.tight.history import TightHistory
from navlearn.gnss.sight import sight
from navlearn.states import InsState, SatelliteRanges, Trajectory


class RangeRecord(NamedTuple):
    """R receptions of S satellites as a filter saw them, shape (R, S) each unless said otherwise.

    What was not received is NaN.

    Attributes:
        t: Times of the receptions, s, shape (R,).
        reception: Which of the filter's receptions each is, int64, shape (R,).
        taken: Whether the filter took the pseudorange, bool.
        residual: Measured minus what the belief after the update says, m.
        innovation: Measured minus what the belief before the update says, m.
        spread: Standard deviation that the filter gives its innovation, m.
        predicted: Pseudorange as predicted before the update, m.
        elevation: Elevation of the satellite, rad.
        cn0: Carrier-to-noise density, dB-Hz.
        along_sight: Speed of the car toward the satellite, m/s.
        speed: Speed over ground, m/s.
    """

    t: Tensor
    reception: Tensor
    taken: Tensor
    residual: Tensor
    innovation: Tensor
    spread: Tensor
    predicted: Tensor
    elevation: Tensor
    cn0: Tensor
    along_sight: Tensor
    speed: Tensor


def range_record(history: TightHistory, ranges: SatelliteRanges, t: Tensor) -> RangeRecord:
    """Return what a filter made of its receptions.

    Args:
        history: History of one drive, no batch axis.
        ranges: The receptions that the filter was given, shape (M, S) each.
        t: Their times, s, shape (M,).

    Raises:
        ShapeError: The history speaks of other receptions or satellites.
    """
    slots = ranges.pseudorange.shape[-1]
    block = torch.nonzero(history.reception >= 0).squeeze(-1)
    reception = history.reception[block]
    last = int(reception.max()) if len(reception) else -1
    if history.residual.ndim != 2 or history.residual.shape[-1] != slots or last >= len(t):
        raise ShapeError(
            f"range record: residuals have shape {tuple(history.residual.shape)} and reach "
            f"reception {last}; expected (K, {slots}) and at most {len(t)} receptions"
        )
    heard = (ranges.has_range[reception] > 0.5) & torch.isfinite(history.innovation[block])

    def of(channel: Tensor) -> Tensor:
        return torch.where(heard, channel.detach().double(), torch.nan)

    position, velocity = _motion(history.trajectory, history.end[block])
    seen = sight(*position, ranges.satellite[reception])
    taken = heard & believed(history.verdict[block][:, :slots])
    along = (seen.unit * velocity.unsqueeze(-2)).sum(-1)
    return RangeRecord(
        t=t[reception],
        reception=reception,
        taken=taken,
        residual=of(history.residual[block]),
        innovation=of(history.innovation[block]),
        spread=of(history.spread[block].clamp(min=0.0).sqrt()),
        predicted=of(ranges.pseudorange[reception] - history.innovation[block]),
        elevation=of(ranges.elevation[reception]),
        cn0=of(ranges.cn0[reception]),
        along_sight=of(along),
        speed=of(torch.linalg.vector_norm(velocity, dim=-1).unsqueeze(-1).expand_as(along)),
    )


def joined(before: RangeRecord, after: RangeRecord) -> RangeRecord:
    """Return two records, one after the other.

    Args:
        before: The earlier.
        after: The later, of the same satellites.
    """
    return RangeRecord(*(torch.cat(pair) for pair in zip(before, after, strict=True)))


def _motion(
    path: Trajectory | InsState, end: Tensor
) -> tuple[tuple[Tensor, Tensor, Tensor], Tensor]:
    """Return latitude, longitude and height, and velocity ENU (..., 3), at some samples."""
    position = (path.lat[end], path.lon[end], path.height[end])
    if isinstance(path, InsState):
        return position, path.v_l[end]
    return position, torch.stack((path.v_e[end], path.v_n[end], path.v_u[end]), -1)
