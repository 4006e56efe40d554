"""One pass of the tight filter's fast form: every block linearised at its guess, one linear filter.

What is measured goes into the linear filter as information: one reception has more rows than there
are error states. What the antenna's velocity does beside the states is taken out of it first.
"""

from typing import Any, NamedTuple

import torch
from torch import Tensor

from navlearn.filters.chunks import Filtered
from navlearn.filters.ekf import symmetrized
from navlearn.filters.information_scan import InformationSteps, filter_information
from navlearn.filters.tight_belief import TightBelief, map_tree
from navlearn.fusion.gated_pass import UNROLLED, everything_believed
from navlearn.fusion.gating import Judged
from navlearn.fusion.measured import Measured
from navlearn.fusion.measurements import Verdict
from navlearn.fusion.robust import weights
from navlearn.fusion.tight.fast_gate import (
    Said,
    own_judged_over_time,
    ranges_judged_over_time,
    same,
)
from navlearn.fusion.tight.integrity import RangesJudged, judged_ranges
from navlearn.fusion.tight.model import SURPRISES, TightModel
from navlearn.fusion.tight.packing import Places
from navlearn.fusion.tight.prediction import TightAhead
from navlearn.fusion.tight.ranges import with_surprise
from navlearn.fusion.tight.update import stacked_rows, with_covariance
from navlearn.fusion.tight.vehicle import Antenna

NEARLY = 1e-2
"""By how much clocks may be set differently in the last pass, m or m/s: they are then as good as
unknown, so that next to nothing of it is left."""

ROUGH = {
    **dict.fromkeys(("east", "north", "up"), 30.0),
    **dict.fromkeys(("v_east", "v_north", "v_up"), 2.0),
    **dict.fromkeys(("azimuth", "phi_up"), 0.1),
    **dict.fromkeys(("phi_east", "phi_north"), 0.03),
    "clock_bias": 30.0,
    "clock_drift": 3.0,
}
"""Deviations of a first guess, by which it is judged before any filter has run, m, m/s and rad;
sensor parameters are as uncertain as at the start, and offsets between systems as the bias."""


class Linear(NamedTuple):
    """All blocks linearised at a guess; deviations are from the blocks' predicted ends.

    Attributes:
        ahead: Prediction, batch shape (B, K).
        shift: By how much a block's end moves because the one before ends elsewhere than the block
            was guessed to start, shape (B, K, n + c).
        antenna: The antenna at the receptions.
        found: What ranges say there, at places.
        series: Variances with which they count, shape (B, K, 2 P).
        own: What the vehicle measures of itself.
        places: Which satellite stands where.
    """

    ahead: TightAhead
    shift: Tensor
    antenna: Antenna
    found: Measured
    series: Tensor
    own: Measured
    places: Places


class BehindRanges(NamedTuple):
    """What the filter found behind the gate.

    Attributes:
        filtered: Deviations and covariances; the mean before an update is that before clocks are
            set.
        found: Ranges against the filter's own prediction.
        own: What the vehicle measures of itself, against that.
        said: What is believed of them.
        used: What was believed to get there.
    """

    filtered: Filtered
    found: Measured
    own: Measured
    said: Said
    used: Said

    @property
    def reproduced(self) -> bool:
        """Whether the gate says again what it had said."""
        return same(self.said, self.used, NEARLY)


def filtered_behind_ranges(
    model: TightModel, start: TightBelief[Any], linear: Linear, said: Said | None, rounds: int
) -> BehindRanges:
    """Filter all blocks, and renew what is believed of them.

    Args:
        model: The filter.
        start: Belief before the first block, batch shape (B,).
        linear: The linearised blocks.
        said: What to believe; None judges by the first guess.
        rounds: How often at most that is renewed.

    Returns:
        What was found.
    """
    used = _first_said(model, start, linear) if said is None else said
    zero = torch.zeros_like(linear.shift[:, 0])
    gate, rows = model.vehicle.gate, model.vehicle.rows
    unrolled = UNROLLED if gate.weighs and torch.is_grad_enabled() else 0
    while True:
        set_by = torch.nn.functional.pad(used.ranges.anew.shift, (model.first_clock, 0))
        extra = torch.diag_embed(used.opened)
        steps = InformationSteps(
            linear.ahead.transition,
            linear.shift + set_by,
            linear.ahead.noise + extra,
            *information(model, linear, used),
        )
        filtered = filter_information(zero, start.covariance, steps)
        # clocks are set and states opened after the gate has judged
        filtered = filtered._replace(
            prior_mean=filtered.prior_mean - set_by,
            prior_covariance=filtered.prior_covariance - extra,
        )
        new, found, own = _judged(model, start, linear, filtered)
        if unrolled > 0:
            unrolled -= 1
            weight = weights(gate, rows, new.own.nis, used.own.verdict)
            used = used._replace(own=used.own._replace(weight=weight))
            continue
        rounds -= 1
        done = BehindRanges(filtered, found, own, new, used)
        if rounds <= 0 or done.reproduced:
            return done
        used = new


def information(model: TightModel, linear: Linear, said: Said) -> tuple[Tensor, Tensor]:
    """Return what believed measurements tell of the error states: Λ and η.

    With s the surprises and D their covariance, J the information of states and surprises, that of
    the states alone is J_xx − J_xs D (I + J_ss D)⁻¹ J_sx.

    Args:
        model: The filter.
        linear: The linearised blocks.
        said: What is believed.

    Returns:
        Λ, shape (B, K, n + c, n + c), and η, shape (B, K, n + c).
    """
    # against the clock as it was: what it is set to is part of the mean
    still = said.ranges.anew._replace(shift=torch.zeros_like(said.ranges.anew.shift))
    ranges = said.ranges._replace(anew=still)
    found = linear.found._replace(variance=linear.series)
    rows = stacked_rows(model, found, ranges, linear.own, said.own)
    weighted = (rows.observation / rows.variance.unsqueeze(-1)).transpose(-1, -2)
    J = weighted @ torch.cat((rows.observation, rows.innovation.unsqueeze(-1)), -1)
    n = model.size
    D = linear.antenna.velocity_variance
    eye = torch.eye(SURPRISES, dtype=D.dtype, device=D.device)
    inner = eye + J[..., n:, n:-1] * D.unsqueeze(-2)
    known = torch.linalg.solve(inner, torch.cat((J[..., n:, :n], J[..., n:, -1:]), -1))
    told = torch.cat((J[..., :n, :n], J[..., :n, -1:]), -1)
    told = told - J[..., :n, n:-1] @ (D.unsqueeze(-1) * known)
    return symmetrized(told[..., :n]), told[..., n]


def _judged(
    model: TightModel, start: TightBelief[Any], linear: Linear, filtered: Filtered
) -> tuple[Said, Measured, Measured]:
    """Return what is believed against a filter's own prediction, and that."""
    found, own, n = linear.found, linear.own, model.first_clock
    moved = filtered.prior_mean.unsqueeze(-1)
    by_state = found.observation[..., : model.size]
    found = found._replace(innovation=found.innovation - (by_state @ moved).squeeze(-1))
    by_own = (own.observation @ moved[..., :n, :]).squeeze(-1)
    own = own._replace(innovation=own.innovation - by_own)
    covariance = with_surprise(filtered.prior_covariance, linear.antenna)
    ranges = ranges_judged_over_time(model, found, covariance, start.refused, linear.places)
    prior = with_covariance(linear.ahead.belief, filtered.prior_covariance)
    heard = own_judged_over_time(model, own, prior, start.vehicle.refused, ranges)
    return _said(model, ranges, heard, own), found, own


def _said(model: TightModel, ranges: RangesJudged, heard: Judged, own: Measured) -> Said:
    opened = ranges.anew.variance[..., : model.size]
    if bool((heard.verdict == int(Verdict.ACCEPTED_BY_RESET)).any()):
        more = model.vehicle.opened(heard.verdict, own, own.innovation)
        opened = opened + torch.nn.functional.pad(more, (0, model.size - model.first_clock))
    shift = ranges.anew.shift.detach()
    anew = ranges.anew._replace(shift=shift)
    return Said(ranges._replace(anew=anew), heard, opened.detach())


@torch.no_grad()
def _first_said(model: TightModel, start: TightBelief[Any], linear: Linear) -> Said:
    """Return what is believed of a first guess, as roughly known as it is."""
    own, count = linear.own, linear.shift.shape[1]
    at_start = start.covariance.diagonal(dim1=-2, dim2=-1)
    rough = at_start.unsqueeze(1).expand(-1, count, -1).clone()
    for k, name in enumerate(model.names):
        if name in ROUGH or name.startswith("system_offset"):
            rough[..., k] = ROUGH.get(name, ROUGH["clock_bias"]) ** 2
    rough[:, 0] = torch.maximum(rough[:, 0], at_start)
    found, antenna = map_tree((linear.found, linear.antenna), Tensor.detach)
    covariance = with_surprise(torch.diag_embed(rough), antenna)
    patient = start.refused.new_zeros((*rough.shape[:2], found.present.shape[-1] + 2))
    ranges = judged_ranges(model, found, covariance, patient)
    return _said(model, ranges, everything_believed(model.vehicle, own.present), own)
