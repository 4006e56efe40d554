"""A gyro-rate error model from a drive's past: terms, their rows, and the fit at any origin.

The terms are physics' own, chosen by FOS among products of channels, or the powers of cascades
that PCI found; their coefficients are always those of one weighted ridge on the whole past.
"""

import platform
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Literal, NamedTuple

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
    PHYSICAL_TERMS,
    PRIOR_SIGMA,
    GyroTerms,
    prior_sigmas,
    product_terms,
)
from navlearn.error_models.regressors import average_samples, build_regressors
from navlearn.error_models.ridge import RidgeModel, RidgeOptions, term_values
from navlearn.errors import FitError
from navlearn.fusion.options import EkfOptions
from navlearn.learning.azimuth_regression import (
    AzimuthCurve,
    AzimuthNoise,
    AzimuthRows,
    azimuth_curve,
    whitened_rows,
)
from navlearn.learning.weighted_ridge import RidgeSolution, solve_ridge
from navlearn.navigator import NavigatorRun
from navlearn.states import RissSample


@dataclass(frozen=True, kw_only=True)
class GyroRateOptions:
    """How a gyro-rate error model is learned.

    Attributes:
        structure: Where terms come from: ``ridge`` takes ``terms``, ``fos`` and ``pci`` find
            them.
        terms: Terms of ``ridge``.
        factors: Channels and magnitudes of which ``fos`` and ``pci`` make terms.
        degree: Largest degree of a product of ``fos``.
        power: Degree of the polynomials of ``pci``.
        max_terms: Most terms of ``fos``, most cascades of ``pci``.
        false_alarm: Chance that white noise alone has a term or cascade accepted.
        structure_every: Longest time that found terms serve before others are looked for, s.
        priors: Standard deviation of coefficients before anything is learned, SI.
        other_prior: Rate error that a term without prior is expected to make, rad/s.
        average: Longest time over which channels are averaged before terms are formed, s.
        noise: What the azimuth error holds beside the terms.
        fix_variance: Factor on the variance that the filter gives what a fix told.
        seed: Seed of the cascades that ``pci`` tries.
        safeguard: Clamps inputs and limits the correction.
        output_limit: In training standard deviations of the correction.
    """

    structure: Literal["ridge", "fos", "pci"] = "ridge"
    terms: tuple[str, ...] = PHYSICAL_TERMS
    factors: tuple[str, ...] = ("yaw_rate", "abs_yaw_rate", "f_x", "f_y", "speed", "acceleration")
    degree: int = 2
    power: int = 3
    max_terms: int = 6
    false_alarm: float = 0.05
    structure_every: float = 240.0
    priors: Mapping[str, float] = field(default_factory=lambda: PRIOR_SIGMA)
    other_prior: float = 1e-3
    average: float = 0.1
    noise: AzimuthNoise = field(default_factory=AzimuthNoise)
    fix_variance: float = 0.4
    seed: int = 0
    safeguard: bool = True
    output_limit: float = 5.0


class GyroPast(NamedTuple):
    """A drive's past, as terms are formed from it.

    Attributes:
        run: The filter's run.
        filter: Its options.
        inputs: Names of the channels.
        u: Channels averaged over ``block`` samples, shape (S, m).
        block: Samples per row of ``u``.
        end: Only samples before this one exist.
    """

    run: NavigatorRun
    filter: EkfOptions
    inputs: tuple[str, ...]
    u: Tensor
    block: int
    end: int


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


def gyro_past(
    run: NavigatorRun, filter_options: EkfOptions, inputs: tuple[str, ...], average: float, end: int
) -> GyroPast:
    """Return a drive's past with its channels averaged.

    Args:
        run: The filter's run.
        filter_options: Its options.
        inputs: Names of the channels.
        average: Longest time over which channels are averaged, s.
        end: Only samples before this one exist.
    """
    block = max(1, int(average / float(run.samples.dt.median()) + 1e-6))
    u = averaged_channels(RissSample(*(c[:end] for c in run.samples)), inputs, block)
    return GyroPast(run, filter_options, inputs, u, block, end)


def averaged_channels(samples: RissSample, inputs: tuple[str, ...], block: int) -> Tensor:
    """Return channels averaged over blocks of samples, the last, unfinished block included.

    Args:
        samples: Intervals, shape (T,) each.
        inputs: Names of the channels.
        block: Samples per row.

    Returns:
        Shape (⌈T / block⌉, m).
    """
    missing = -samples.dt.shape[-1] % block
    if missing:
        samples = RissSample(*(torch.cat((c, c[-1:].expand(missing))) for c in samples))
    return build_regressors(average_samples(samples, block), inputs)


def at_samples(rows: Tensor, block: int, count: int) -> Tensor:
    """Return rows of averages repeated for each of their samples, shape (count, ...).

    Args:
        rows: Shape (S, ...).
        block: Samples per row.
        count: Number of samples.
    """
    return rows.repeat_interleave(block, 0)[:count]


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


def past_curve(past: GyroPast, values: Tensor, options: GyroRateOptions) -> AzimuthCurve:
    """Return the azimuth error of the raw gyro over a past, and terms integrated along it.

    Args:
        past: The past.
        values: Terms by row of ``past.u``, shape (S, J).
        options: Noise.
    """
    terms = at_samples(values, past.block, past.end)
    curve = azimuth_curve(past.run, past.filter, terms, past.end)
    return curve._replace(variance=curve.variance * options.fix_variance)


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
        seed=0,
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
