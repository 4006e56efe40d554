"""White noise, bias instability and random walk, read off an Allan deviation.

[IEEE952] Eqs. (C.10), (C.13), (C.16), (C.18): σ²(τ) = 3 Q²/τ² + N²/τ + (2 ln 2/π) B² + K² τ/3. The
four are fitted together, none negative; each is then told at the averaging time that tells it
best, with that time's interval of confidence.
"""

import math
from dataclasses import dataclass

import numpy as np
from scipy.optimize import nnls

from navlearn.logs.allan.deviation import AllanCurve
from navlearn.logs.interval_means import FloatArray

FLAT = 2.0 * math.log(2.0) / math.pi
"""Allan variance of flicker noise of unit bias instability, where it is flat."""

LEAST_SHARE = 0.5
"""A term is told where it makes at least this share of the variance, and surely some of it."""

CLOSE, LOOSE = 0.02, 0.1
"""Share of the variance closer than which curve and fit are not held together; the second where
the four terms are not all that there is, or the best known averaging times would have it their way.
"""

MISFIT = 1.4
"""A curve this much above its terms, or below, has something else in it."""

NAMES = ("quantisation", "white", "instability", "walk")


@dataclass(frozen=True, kw_only=True)
class Term:
    """One coefficient.

    Attributes:
        value: The coefficient; NaN where the curve does not show it.
        low: Lower end of its interval of confidence; 0 where it is not shown.
        high: Upper end, known even where it is not shown.
        tau: Averaging time that tells it, s.
    """

    value: float
    low: float
    high: float
    tau: float

    @property
    def shown(self) -> bool:
        """Whether the curve shows the term."""
        return math.isfinite(self.value)


@dataclass(frozen=True, kw_only=True)
class NoiseTerms:
    """Coefficients of one axis, whose unit is u.

    Attributes:
        quantisation: Q, u·s.
        white: N, u·√s: angle random walk of a gyro (rad/√s), velocity random walk of an
            accelerometer (m/s/√s).
        instability: B, u.
        walk: K, u/√s: rate random walk of a gyro (rad/s/√s).
        least: Lowest point of the Allan deviation, u: what standing longer does not average away.
        misfit: Deviation over that of the four terms, where they surely differ most.
        misfit_tau: Averaging time where they do, s.
        foreign: Whether they surely differ by :data:`MISFIT` and more: something else is there.
    """

    quantisation: Term
    white: Term
    instability: Term
    walk: Term
    least: float
    misfit: float
    misfit_tau: float
    foreign: bool


def noise_terms(curve: AllanCurve) -> NoiseTerms:
    """Return the coefficients that a curve shows.

    Args:
        curve: Allan deviation of a sensor at rest.
    """
    shapes = np.stack(
        (
            3.0 / curve.tau**2,
            1.0 / curve.tau,
            np.full_like(curve.tau, FLAT),
            curve.tau / 3.0,
        ),
        axis=-1,
    )
    squares = _fitted(curve, shapes, CLOSE)
    foreign = _misfit(curve, shapes @ squares)[2]
    if foreign:
        squares = _fitted(curve, shapes, LOOSE)
    parts = shapes * squares
    total = parts.sum(-1)
    doubt = np.abs(np.log(curve.deviation / np.sqrt(total))) * foreign
    terms = {
        name: _term(curve, shapes[:, k], parts[:, k] / total, doubt) for k, name in enumerate(NAMES)
    }
    misfit, at, _ = _misfit(curve, total)
    return NoiseTerms(
        **terms,
        least=float(curve.deviation.min()),
        misfit=misfit,
        misfit_tau=at,
        foreign=foreign,
    )


def _misfit(curve: AllanCurve, variance: FloatArray) -> tuple[float, float, bool]:
    """Return deviation over that of a fit where they differ most, where, and whether it counts."""
    ratio = curve.deviation / np.sqrt(variance)
    # what a few degrees of freedom do is no misfit
    sure = np.abs(np.log(ratio)) - 2.0 / np.sqrt(curve.freedom)
    worst = int(np.argmax(sure))
    return float(ratio[worst]), float(curve.tau[worst]), bool(sure[worst] > math.log(MISFIT))


def _fitted(curve: AllanCurve, shapes: FloatArray, closest: float) -> FloatArray:
    """Return squared coefficients, none negative, by weighted least squares."""
    variance = curve.deviation**2
    level = variance
    squares = np.zeros(shapes.shape[-1])
    for _ in range(5):
        # an estimate of f degrees of freedom is off by √(2/f) of its expectation
        weight = np.sqrt(0.5 * curve.freedom) / level
        weight = np.minimum(weight, 1.0 / (closest * level))
        scale = np.linalg.norm(shapes * weight[:, None], axis=0)
        found, _ = nnls(shapes * weight[:, None] / scale, variance * weight)
        squares = found / scale
        level = np.maximum(shapes @ squares, 1e-3 * variance)
    return squares


def _term(curve: AllanCurve, shape: FloatArray, share: FloatArray, doubt: FloatArray) -> Term:
    """Return one coefficient where it is told best: most of a variance that is well known."""
    ceiling = curve.high / np.sqrt(shape)
    bound = int(np.argmin(ceiling))
    hidden = Term(value=math.nan, low=0.0, high=float(ceiling[bound]), tau=float(curve.tau[bound]))
    shown = share >= LEAST_SHARE
    if not shown.any():
        return hidden
    unsure = np.where(shown, 2.0 / curve.freedom + (1.0 - share) ** 2 + (2.0 * doubt) ** 2, np.inf)
    at = int(np.argmin(unsure))
    square, part = curve.deviation[at] ** 2, share[at]
    value = square * part / shape[at]
    off = math.exp(2.0 * float(doubt[at]))
    low, high = curve.low[at] ** 2 / square / off, curve.high[at] ** 2 / square * off
    # at least what is left if the other terms are right, at most all of the variance
    least = 1.0 - (1.0 - low) / part
    if least <= 0.0:
        return hidden
    return Term(
        value=math.sqrt(value),
        low=math.sqrt(value * least),
        high=math.sqrt(high * square / shape[at]),
        tau=float(curve.tau[at]),
    )
