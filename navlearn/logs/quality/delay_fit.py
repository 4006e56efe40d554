"""Delay between two signals by robust least squares.

One signal is taken as observed, the other as known at any time; delay, its drift, and the
coefficients that turn one into the other are estimated together: a grid search on the sum of
absolute residuals for the start, then Gauss–Newton with Tukey's biweight [Huber2009, §7.8].
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from navlearn.logs.quality.signals import Array, Mask

Design = Callable[[Array], Array]
"""Regressors, shape (n, k), of all observations for given delays of shape (n,)."""

_HALF_STEP = 0.02


@dataclass(frozen=True, kw_only=True)
class DelayFit:
    """A fitted delay.

    Attributes:
        delay: How late the observed signal is stamped at ``middle``, s.
        middle: Mean time of the observations, s.
        delay_std: Its standard deviation, s.
        drift: Growth of the delay, s/s; zero where none was fitted.
        drift_std: Its standard deviation, s/s; zero where none was fitted.
        coefficients: Factors of the regressors.
        coefficient_std: Their standard deviations.
        correlation: Between the observed and the fitted signal, outliers down-weighted.
        residual: Robust standard deviation of what remains.
        samples: Observations used.
        at_edge: Whether the best delay lies at the end of the searched range.
    """

    delay: float
    middle: float
    delay_std: float
    drift: float
    drift_std: float
    coefficients: Array
    coefficient_std: Array
    correlation: float
    residual: float
    samples: int
    at_edge: bool


def fit_delay(
    t: Array,
    observed: Array,
    design: Design,
    *,
    weight: Array,
    limit: float,
    with_drift: bool = False,
    overlap: int = 1,
) -> DelayFit | None:
    """Fit ``observed(t) = design(delay) @ coefficients``, or return None with too few samples.

    Args:
        t: Times of the observations, s.
        observed: Observations, shape (n,).
        design: Regressors as a function of the delay of each observation.
        weight: Square roots of the weights, shape (n,).
        limit: Largest delay searched, s.
        with_drift: Whether the delay may grow linearly.
        overlap: Neighbouring observations that share data; widens the standard deviations.
    """
    ends = [design(np.full(len(t), d)) for d in (-limit - 0.3, limit + 0.3)]
    usable = np.isfinite(observed) & np.isfinite(weight) & (weight > 0.0)
    for end in ends:
        usable &= np.all(np.isfinite(end), axis=1)
    count = ends[0].shape[1]
    if np.count_nonzero(usable) < 10 * (count + 1):
        return None

    def rows(delay: Array) -> Array:
        x = design(delay)[usable] * weight[usable, None]
        return np.where(np.isfinite(x), x, 0.0)

    y = observed[usable] * weight[usable]
    start, at_edge = _search(y, rows, len(t), limit)
    middle = float(np.mean(t[usable]))
    centred = t - middle
    fit = _gauss_newton(y, rows, centred, usable, start, with_drift=with_drift)
    if fit is None:
        return None
    solution, std, robust_weight, fitted, scale = fit
    widen = float(np.sqrt(max(1, overlap)))
    return DelayFit(
        delay=float(solution[count]),
        middle=middle,
        delay_std=float(std[count]) * widen,
        drift=float(solution[count + 1]) if with_drift else 0.0,
        drift_std=float(std[count + 1]) * widen if with_drift else 0.0,
        coefficients=solution[:count],
        coefficient_std=std[:count] * widen,
        correlation=_correlation(y, fitted, robust_weight),
        residual=scale,
        samples=int(np.count_nonzero(usable)),
        at_edge=at_edge,
    )


def _search(
    y: Array, rows: Callable[[Array], Array], count: int, limit: float
) -> tuple[float, bool]:
    grid = np.linspace(-limit, limit, 2 * round(limit / 0.1) + 1)
    cost = [_absolute_cost(y, rows(np.full(count, d))) for d in grid]
    best = int(np.argmin(cost))
    return float(grid[best]), best in (0, len(grid) - 1)


def _absolute_cost(y: Array, x: Array) -> float:
    residual = y - x @ _solve(x, y)
    for _ in range(3):
        root = 1.0 / np.sqrt(np.maximum(np.abs(residual), 1e-2 * np.std(y) + 1e-12))
        residual = y - x @ _solve(x * root[:, None], y * root)
    return float(np.sum(np.abs(residual)))


def _solve(x: Array, y: Array) -> Array:
    # Normal equations with columns of one size: few columns, and the fit is repeated often.
    size = np.sqrt(np.sum(x * x, axis=0))
    scaled = x / np.where(size > 0.0, size, 1.0)
    normal = scaled.T @ scaled + 1e-12 * np.eye(x.shape[1])
    return np.asarray(np.linalg.solve(normal, scaled.T @ y), dtype=np.float64) / np.where(
        size > 0.0, size, 1.0
    )


def _gauss_newton(
    y: Array,
    rows: Callable[[Array], Array],
    centred: Array,
    usable: Mask,
    start: float,
    *,
    with_drift: bool,
) -> tuple[Array, Array, Array, Array, float] | None:
    delay = np.array([start, 0.0])
    robust = np.ones(len(y))
    for turn in range(25):
        each = delay[0] + delay[1] * centred
        x = rows(each)
        beta = _solve(x * np.sqrt(robust)[:, None], y * np.sqrt(robust))
        slope = (rows(each + _HALF_STEP) - rows(each - _HALF_STEP)) @ beta / (2.0 * _HALF_STEP)
        columns = [x, slope[:, None]]
        if with_drift:
            columns.append((slope * centred[usable])[:, None])
        jacobian = np.concatenate(columns, axis=1)
        residual = y - x @ beta
        scale = max(1.4826 * float(np.median(np.abs(residual))), 1e-12)
        # A start a little off makes every turn look like an outlier: open wide, then close.
        open_scale = scale * max(1.0, 5.0 - turn)
        robust = np.clip(1.0 - (residual / (4.685 * open_scale)) ** 2, 0.0, None) ** 2
        root = np.sqrt(robust)
        step = _solve(jacobian * root[:, None], residual * root)[x.shape[1] :]
        step[0] = np.clip(step[0], -0.3, 0.3)
        delay[: len(step)] += step
        if turn > 4 and abs(step[0]) < 1e-5:
            break
    x = rows(delay[0] + delay[1] * centred)
    fitted = x @ beta
    std = _standard_deviations(jacobian, y - fitted, robust)
    if std is None:
        return None
    solution = np.concatenate((beta, delay[: 2 if with_drift else 1]))
    return solution, std, robust, fitted, scale


def _standard_deviations(jacobian: Array, residual: Array, robust: Array) -> Array | None:
    normal = (jacobian * robust[:, None]).T @ jacobian
    freedom = float(np.sum(robust)) - jacobian.shape[1]
    size = np.sqrt(np.diag(normal))
    if freedom <= 0.0 or not np.all(size > 0.0):
        return None
    scaled = normal / np.outer(size, size)
    if np.linalg.cond(scaled) > 1e10:
        return None
    r = residual * np.sqrt(robust)
    rho = float(np.sum(r[1:] * r[:-1]) / max(float(np.sum(r * r)), 1e-300))
    correlated = (1.0 + rho) / (1.0 - rho) if 0.0 < rho < 1.0 else 1.0
    variance = float(np.sum(r * r)) / freedom * correlated
    return np.asarray(np.sqrt(np.diag(np.linalg.inv(scaled)) * variance) / size, dtype=np.float64)


def _correlation(y: Array, fitted: Array, robust: Array) -> float:
    a = y - np.average(y, weights=robust)
    b = fitted - np.average(fitted, weights=robust)
    power = float(np.sum(robust * a * a)) * float(np.sum(robust * b * b))
    return float(np.sum(robust * a * b) / np.sqrt(power)) if power > 0.0 else 0.0
