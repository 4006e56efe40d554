"""Where the terms of a gyro-rate error model come from: physics, FOS, or cascades.

FOS searches among integrated products of channels, whitened, for the few that explain the
azimuth error; what it finds is fitted once more by the ridge with physical priors.
"""

import math
from collections.abc import Callable, Sequence
from typing import Any

import torch

from navlearn.error_models.base import TrainingSource
from navlearn.error_models.fos_fit import fit_fos
from navlearn.error_models.fos_options import FosOptions
from navlearn.error_models.gyro_terms import (
    GyroTerms,
    candidate_names,
    channels_of,
    product_terms,
)
from navlearn.error_models.pci_options import PciOptions
from navlearn.learning.azimuth_regression import AzimuthCurve, sums_over_blocks
from navlearn.learning.gyro_cascades import cascade_terms, smoothed_rate_error
from navlearn.learning.gyro_past import GyroPast, GyroRateOptions, at_samples, past_curve
from navlearn.learning.gyro_rate import (
    GyroEvidence,
    GyroFit,
    at_origin,
    fit_at,
    fit_physical,
    gather,
    rows_before,
)
from navlearn.learning.weighted_ridge import solve_ridge

RATE_WALK = math.radians(0.3)
"""How fast a gyro's error may change where cascades are sought, rad/s/√s: as turns begin."""


def model_inputs(options: GyroRateOptions) -> tuple[str, ...]:
    """Return the channels that a model needs, the yaw rate among them.

    Args:
        options: What is learned.
    """
    if options.structure == "pci":
        return options.factors
    return channels_of(options.terms if options.structure == "ridge" else options.factors)


def fit_gyro_rate(
    past: GyroPast, options: GyroRateOptions, origins: Sequence[int], source: TrainingSource
) -> list[GyroFit]:
    """Fit a gyro-rate error model at several origins of a drive.

    Args:
        past: The drive's past.
        options: What is learned.
        origins: Samples, rising; each model rests on what was known before its own.
        source: What else is known about the data.

    Returns:
        One fit per origin.

    Raises:
        FitError: Nothing was known before an origin.
    """
    if options.structure == "ridge":
        return fit_physical(past, options, origins, source)
    fits: list[GyroFit] = []
    find = _fos_evidence if options.structure == "fos" else _pci_evidence
    evidence_at = find(past, options, origins[0])
    for together in _in_groups(past, origins, options.structure_every):
        evidence = evidence_at(together[0])
        counts = rows_before(evidence.rows, together)
        rows = evidence.rows
        found = solve_ridge(rows.columns, rows.target, evidence.prior, counts)
        fits += [
            fit_at(past, options, evidence, at_origin(found, k), origin, source)
            for k, origin in enumerate(together)
        ]
    return fits


def _in_groups(past: GyroPast, origins: Sequence[int], every: float) -> list[list[int]]:
    """Return origins that share the structure found at the first of them; the last finds its own.

    Args:
        past: The drive's past.
        origins: Samples, rising.
        every: Longest time that a structure serves, s.
    """
    span = round(every / float(past.run.samples.dt.median()))
    groups: list[list[int]] = []
    for origin in origins:
        last = origin == origins[-1]
        if not groups or last or origin - groups[-1][0] >= span:
            groups.append([])
        groups[-1].append(origin)
    return groups


def _fos_evidence(
    past: GyroPast, options: GyroRateOptions, first: int
) -> Callable[[int], GyroEvidence]:
    """Return what tells the terms that FOS chooses by what was known before a sample."""
    names = candidate_names(options.factors, options.degree)
    terms = product_terms(names, past.inputs, past.run.alignment.gyro_bias)
    evidence = gather(past, terms, options, first)

    def chosen(origin: int) -> GyroEvidence:
        count = int(rows_before(evidence.rows, [origin])[0])
        return some_terms(evidence, chosen_terms(evidence, options, count))

    return chosen


def _pci_evidence(
    past: GyroPast,
    options: GyroRateOptions,
    first: int,  # noqa: ARG001  # cascades have priors of their own at every origin
) -> Callable[[int], GyroEvidence]:
    """Return what tells the powers of cascades found on what was known before a sample."""
    search = PciOptions(
        inputs=len(past.inputs),
        lags=0,
        degree=options.power,
        cascades=options.max_terms,
        tried=1000,
        level=options.false_alarm,
        seed=options.seed,
    )
    curve = past_curve(past, past.u[:, :0], options)
    dt = past.run.samples.dt[: past.end].unsqueeze(-1)
    channels = at_samples(past.u, past.block, past.end) * dt
    means = sums_over_blocks(channels, curve.end) / curve.duration.unsqueeze(-1)

    def found(origin: int) -> GyroEvidence:
        count = int((curve.end < origin).sum())
        before = AzimuthCurve(*(part[:count] for part in curve))
        rate, variance = smoothed_rate_error(before, options.noise, RATE_WALK)
        weight = torch.where(torch.isfinite(before.error), 1.0 / variance, 0.0)
        weight = weight / weight.mean().clamp(min=1e-300)
        return gather(past, cascade_terms(means[:count], rate, weight, search), options, origin)

    return found


def chosen_terms(evidence: GyroEvidence, options: GyroRateOptions, count: int) -> list[int]:
    """Return which candidates FOS chooses on the first rows, in the order of the search.

    Args:
        evidence: Rows of all candidates.
        options: Rules of the search.
        count: Number of rows.
    """
    if count < 2:
        return []
    search = FosOptions(
        lags=0,
        degree=1,
        max_terms=options.max_terms,
        false_alarm=options.false_alarm,
        exchange_sweeps=2,
        backward=True,
        safeguard=False,
    )
    columns = evidence.rows.columns[:count] * evidence.prior
    fitted = fit_fos(columns, evidence.rows.target[:count].unsqueeze(-1), options=search)
    # A row is an innovation, of mean zero: should the search take the constant, it tells nothing.
    found: Any = fitted.model
    return [term[0][0] for term in found.terms if term]


def some_terms(evidence: GyroEvidence, chosen: Sequence[int]) -> GyroEvidence:
    """Return what was told about some of the terms, in the order given.

    Args:
        evidence: What was told about all.
        chosen: Which terms.
    """
    index = torch.tensor(list(chosen), dtype=torch.long)
    terms, curve, rows = evidence.terms, evidence.curve, evidence.rows
    states = torch.cat((index.new_zeros(1), index + 1))
    return GyroEvidence(
        GyroTerms(tuple(terms.names[k] for k in chosen), terms.form[index], terms.magnitude[index]),
        evidence.prior[index],
        curve._replace(turned=curve.turned[:, index], rest_terms=curve.rest_terms[:, index]),
        rows._replace(
            columns=rows.columns[:, index], angle=rows.angle[:, states], bias=rows.bias[:, states]
        ),
    )
