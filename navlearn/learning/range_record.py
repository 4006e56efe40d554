"""What a tightly coupled filter made of every range that it was given, satellite by satellite.

The raw material of range-error models. What remains of a range after the update is seen relative
to the receiver's clock and to the position, which have taken their share of every satellite's
error: an error common to all satellites is clock, and one that varies with direction is partly
position. A single satellite's error is therefore never seen itself. What is seen is where the
satellite disagrees with the solution of all, and that is what a solution from few of them needs:
ranges less their residuals give any subset of satellites the solution of the whole.
"""

from typing import Final, NamedTuple

import torch
from torch import Tensor

from navlearn.errors import ShapeError
from navlearn.fusion.measurements import Verdict
from navlearn.fusion.tight.history import TightHistory
from navlearn.gnss.sight import sight
from navlearn.states import InsState, SatelliteRanges, Trajectory

TOOK_PART: Final = (int(Verdict.ACCEPTED), int(Verdict.ACCEPTED_BY_RESET))


class RangeRecord(NamedTuple):
    """R receptions of S satellites as a filter saw them, shape (R, S) each unless said otherwise.

    What was not received is NaN.

    Attributes:
        t: Times of the receptions, s, shape (R,).
        reception: Which of the filter's receptions each is, int64, shape (R,).
        taken: Whether the filter took the pseudorange, bool.
        residual: Measured minus what the belief after the update says, m.
        left_out: Measured minus what it would say without this satellite's pseudorange, m.
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
    left_out: Tensor
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
    rows = sight_rows(seen.unit, history, ranges.system)
    verdict = history.verdict[block][:, :slots]
    taken = heard & ((verdict == TOOK_PART[0]) | (verdict == TOOK_PART[1]))
    along = (seen.unit * velocity.unsqueeze(-2)).sum(-1)
    return RangeRecord(
        t=t[reception],
        reception=reception,
        taken=taken,
        residual=of(history.residual[block]),
        left_out=of(left_out_residual(history, block, rows, taken)),
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


def sight_rows(unit: Tensor, history: TightHistory, system: Tensor) -> Tensor:
    """Return how a predicted pseudorange answers to the error states, shape (R, S, n).

    What the lever arm's turning adds is left out: centimetres.

    Args:
        unit: Unit vectors from car to satellite, ENU, shape (R, S, 3).
        history: Tells the number of states.
        system: System of each satellite, int64, shape (S,).
    """
    states = history.belief.covariance.shape[-1]
    clock = states - history.belief.clock.shape[-1]
    rows = unit.new_zeros((*unit.shape[:-1], states))
    rows[..., :3] = -unit
    rows[..., clock] = 1.0
    further = torch.nonzero(system > 0).squeeze(-1)
    rows[:, further, clock + 1 + system[further]] = 1.0
    return rows


def left_out_residual(history: TightHistory, block: Tensor, rows: Tensor, taken: Tensor) -> Tensor:
    """Return residuals against the belief that an update without this one satellite would give.

    For an update with measurements of variance R, residual e and information H P⁺ Hᵀ afterwards,
    the residual without the i-th measurement is eᵢ Rᵢ / (Rᵢ − (H P⁺ Hᵀ)ᵢᵢ).

    Args:
        history: History of one drive.
        block: Blocks, int64, shape (R,).
        rows: Rows of H, shape (R, S, n).
        taken: Which satellites took part; the others were left out as it is, bool, shape (R, S).

    Returns:
        Shape (R, S), m.
    """
    residual = history.residual[block]

    def seen(covariance: Tensor) -> Tensor:
        return ((rows @ covariance) * rows).sum(-1)

    noise = history.spread[block] - seen(history.prior.covariance[block])
    noise = torch.maximum(noise, 1e-6 * history.spread[block])
    free = torch.maximum(noise - seen(history.belief.covariance[block]), 1e-3 * noise)
    return torch.where(taken, residual * noise / free, residual)


def _motion(
    path: Trajectory | InsState, end: Tensor
) -> tuple[tuple[Tensor, Tensor, Tensor], Tensor]:
    """Return latitude, longitude and height, and velocity ENU (..., 3), at some samples."""
    position = (path.lat[end], path.lon[end], path.height[end])
    if isinstance(path, InsState):
        return position, path.v_l[end]
    return position, torch.stack((path.v_e[end], path.v_n[end], path.v_u[end]), -1)
