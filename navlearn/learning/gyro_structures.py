"""Where the terms of a gyro-rate error model come from: physics, FOS, or cascades.

FOS searches among integrated products of channels, whitened, for the few that explain the
azimuth error; what it finds is fitted once more by the ridge with physical priors.
"""

from collections.abc import Sequence
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
from navlearn.learning.gyro_rate import (
    GyroEvidence,
    GyroFit,
    GyroPast,
    GyroRateOptions,
    at_origin,
    fit_at,
    fit_physical,
    gather,
    rows_before,
)
from navlearn.learning.weighted_ridge import solve_ridge


def model_inputs(options: GyroRateOptions) -> tuple[str, ...]:
    """Return the channels that a model needs, the yaw rate among them.

    Args:
        options: What is learned.
    """
    names = options.terms if options.structure == "ridge" else options.factors
    return channels_of(names)


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
    if options.structure == "fos":
        return fit_chosen(past, options, origins, source)
    return fit_physical(past, options, origins, source)


def fit_chosen(
    past: GyroPast, options: GyroRateOptions, origins: Sequence[int], source: TrainingSource
) -> list[GyroFit]:
    """Fit the terms that FOS chooses at each origin.

    Args:
        past: The drive's past.
        options: Factors, degree and rules of the search.
        origins: Samples, rising.
        source: What else is known about the data.

    Returns:
        One fit per origin; one without terms corrects nothing.
    """
    names = candidate_names(options.factors, options.degree)
    terms = product_terms(names, past.inputs, past.run.alignment.gyro_bias)
    evidence = gather(past, terms, options)
    fits = []
    for count, origin in zip(rows_before(evidence.rows, origins).tolist(), origins, strict=True):
        part = some_terms(evidence, chosen_terms(evidence, options, count))
        found = solve_ridge(
            part.rows.columns[:count], part.rows.target[:count], part.prior, torch.tensor([count])
        )
        fits.append(fit_at(past, options, part, at_origin(found, 0), origin, source))
    return fits


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
    # The constant is no candidate here: a row is an innovation, and its mean is zero.
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
