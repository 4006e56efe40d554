"""A gyro-rate error model from a drive's past: terms, their rows, and the fit at any origin.

The terms are physics' own, chosen by FOS among products of channels, or the powers of cascades
that PCI found; their coefficients are always those of one weighted ridge on the whole past.
"""

import platform
from collections.abc import Sequence
from typing import NamedTuple

import torch
from torch import Tensor

import navlearn
from navlearn.error_models.base import (
    FittedErrorModel,
    TrainingCurves,
    TrainingRecord,
    TrainingSource,
)
from navlearn.error_models.gyro_terms import (
    GyroTerms,
    prior_sigmas,
    product_terms,
)
from navlearn.error_models.ridge import RidgeModel, RidgeOptions, term_values
from navlearn.errors import FitError
from navlearn.learning.azimuth_regression import (
    AzimuthCurve,
    AzimuthRows,
    whitened_rows,
)
from navlearn.learning.gyro_past import GyroPast, GyroRateOptions, past_curve
from navlearn.learning.weighted_ridge import RidgeSolution, solve_ridge


class GyroEvidence(NamedTuple):
    """What a drive's past told about some terms of its gyro's error.

    Attributes:
        terms: The terms.
        prior: Standard deviation of each coefficient before, shape (J,).
        curve: The azimuth error of the raw gyro.
        rows: Independent rows of unit variance.
    """

    terms: GyroTerms
    prior: Tensor
    curve: AzimuthCurve
    rows: AzimuthRows


class GyroFit(NamedTuple):
    """A model learned up to an origin, and where it leaves the car there.

    Attributes:
        fitted: The model.
        azimuth: Azimuth at the origin by the corrected gyro and all fixes before, rad, scalar.
        gyro_bias: What the corrected gyro is still off by, rad/s, scalar.
        covariance: Of the errors of both, shape (2, 2).
    """

    fitted: FittedErrorModel
    azimuth: Tensor
    gyro_bias: Tensor
    covariance: Tensor


def gather(past: GyroPast, terms: GyroTerms, options: GyroRateOptions, first: int) -> GyroEvidence:
    """Return what a drive's past told about terms.

    Args:
        past: The past.
        terms: The terms.
        options: Noise and priors.
        first: The first origin; how large terms are is taken from the samples before it.

    Raises:
        FitError: The filter has no past yet.
    """
    values = term_values(past.u, terms.form, terms.magnitude)
    known = values[: max(first // past.block, 1)]
    spread = known.square().mean(0).sqrt()
    curve = past_curve(past, values, options)
    return GyroEvidence(
        terms,
        prior_sigmas(terms.names, spread, options.priors, options.other_prior),
        curve,
        whitened_rows(curve, options.noise),
    )


def fit_physical(
    past: GyroPast, options: GyroRateOptions, origins: Sequence[int], source: TrainingSource
) -> list[GyroFit]:
    """Fit the terms of the options at every origin, from one pass over the past.

    Args:
        past: The past.
        options: Terms, priors and noise.
        origins: Samples, rising; each fit rests on what was known before its own.
        source: What else is known about the data.

    Returns:
        One fit per origin.
    """
    terms = product_terms(options.terms, past.inputs, past.run.alignment.gyro_bias)
    evidence = gather(past, terms, options, origins[0])
    counts = rows_before(evidence.rows, origins)
    found = solve_ridge(evidence.rows.columns, evidence.rows.target, evidence.prior, counts)
    return [
        fit_at(past, options, evidence, at_origin(found, k), origin, source)
        for k, origin in enumerate(origins)
    ]


def rows_before(rows: AzimuthRows, origins: Sequence[int]) -> Tensor:
    """Return how many rows are known before each sample, int64, shape (B,)."""
    return torch.searchsorted(rows.sample, torch.tensor(list(origins), dtype=torch.long))


def at_origin(found: RidgeSolution, k: int) -> RidgeSolution:
    """Return the solution of one origin."""
    return RidgeSolution(*(part[k] for part in found))


def fit_at(
    past: GyroPast,
    options: GyroRateOptions,
    evidence: GyroEvidence,
    found: RidgeSolution,
    origin: int,
    source: TrainingSource,
) -> GyroFit:
    """Return the fit that a solution stands for.

    Args:
        past: The past.
        options: Safeguard.
        evidence: What was told about the terms.
        found: The solution at this origin.
        origin: Samples before this one were learned from; a block ends just before it.
        source: What else is known about the data.

    Raises:
        FitError: No row is known before the origin.
    """
    known = origin // past.block
    if int(found.rows) == 0 or known == 0:
        raise FitError("gyro rate: no fix told anything yet; start the outages later")
    rows, curve = evidence.rows, evidence.curve
    k = int((curve.end < origin).sum()) - 1
    theta = found.coefficients
    by_terms = torch.stack((curve.turned[k] - rows.angle[k, 1:], -rows.bias[k, 1:]))
    rest = torch.stack((rows.angle[k, 0], rows.bias[k, 0])) + by_terms @ theta
    return GyroFit(
        fitted=_fitted_model(past, options, evidence.terms, found, origin, source),
        azimuth=curve.raw[k] - rest[0],
        gyro_bias=rest[1],
        covariance=rows.covariance[k] + by_terms @ found.covariance @ by_terms.T,
    )


def _fitted_model(
    past: GyroPast,
    options: GyroRateOptions,
    terms: GyroTerms,
    found: RidgeSolution,
    origin: int,
    source: TrainingSource,
) -> FittedErrorModel:
    """Return the model of one solution with its record."""
    model = RidgeModel(
        RidgeOptions(
            inputs=len(past.inputs),
            terms=terms.names,
            factors=terms.form.shape[1],
            safeguard=options.safeguard,
            output_limit=options.output_limit,
        )
    )
    model.set_fit(terms, found.coefficients, found.covariance, past.u[: origin // past.block])
    model.eval()
    loss = float(found.chi_square)
    record = TrainingRecord(
        source=source,
        time_span=(0.0, float(past.run.samples.dt[:origin].sum())),
        samples=int(found.rows),
        validation_samples=0,
        trainer=options.structure,
        loop="open",
        iterations=1,
        stopped="closed form",
        seed=options.seed,
        train_loss=loss,
        valid_loss=float("nan"),
        versions=(
            ("navlearn", navlearn.__version__),
            ("torch", str(torch.__version__)),
            ("python", platform.python_version()),
        ),
    )
    curves = TrainingCurves(train=(loss,), valid=())
    return FittedErrorModel(
        kind="ridge", model=model, options=model.options, record=record, curves=curves
    )
