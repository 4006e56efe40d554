"""Means of sampled signals over intervals, by exact integration.

A sampled signal stands for a function of time: straight lines between samples that hold at an
instant, or steps for samples that are themselves means. The mean over an interval is the
difference of the running integral at its ends, so the whole (angle turned, distance driven) is
kept whatever the rates of log and grid.
"""

from typing import Literal

import numpy as np
import numpy.typing as npt

FloatArray = npt.NDArray[np.float64]
Sampling = Literal["instant", "interval"]


def interval_means(
    t: FloatArray, values: FloatArray, edges: FloatArray, *, sampling: Sampling = "instant"
) -> FloatArray:
    """Return the means of a signal over consecutive intervals.

    Outside its samples the signal keeps its first or last value.

    Args:
        t: Times of the samples, s, strictly increasing, shape (K,).
        values: Samples, shape (K,).
        edges: Ends of the intervals, s, increasing, shape (T+1,).
        sampling: ``instant``: samples hold at their time, straight lines between;
            ``interval``: each is the mean over the interval that ends at its time.

    Returns:
        Means over ``[edges[k], edges[k+1]]``, shape (T,).
    """
    if sampling == "interval":
        integral = _integral_of_steps(t, values, edges)
    else:
        integral = _integral_of_lines(t, values, edges)
    return np.diff(integral) / np.diff(edges)


def typical_period(t: FloatArray) -> float:
    """Return the median spacing of samples to the nanosecond, s; zero for fewer than two.

    Rounded, because what rounding left of even stamps must not move a grid when a drive grows.

    Args:
        t: Times, s, shape (K,).
    """
    return round(float(np.median(np.diff(t))), 9) if t.size > 1 else 0.0


def longest_gap(t: FloatArray, start: float, stop: float) -> tuple[float, float]:
    """Return start and length of the longest stretch without a sample, both s.

    Args:
        t: Times, s, increasing, shape (K,), K >= 1.
        start: Begin of the stretch looked at, s.
        stop: Its end, s.
    """
    inside = t[(t > start) & (t < stop)]
    points = np.concatenate(([start], inside, [stop]))
    before = np.searchsorted(t, start, side="right") - 1
    after = np.searchsorted(t, stop, side="left")
    if before >= 0:
        points[0] = t[before]
    if after < t.size:
        points[-1] = t[after]
    spacing = np.diff(points)
    worst = int(np.argmax(spacing))
    return float(points[worst]), float(spacing[worst])


def _integral_of_lines(t: FloatArray, values: FloatArray, at: FloatArray) -> FloatArray:
    if t.size == 1:
        single: FloatArray = values[0] * (at - t[0])
        return single
    step = np.diff(t)
    total = np.concatenate(([0.0], np.cumsum(0.5 * step * (values[1:] + values[:-1]))))
    inner = np.clip(at, t[0], t[-1])
    left = np.clip(np.searchsorted(t, inner, side="right") - 1, 0, t.size - 2)
    elapsed = inner - t[left]
    slope = (values[left + 1] - values[left]) / step[left]
    integral = total[left] + elapsed * (values[left] + 0.5 * slope * elapsed)
    before, after = np.minimum(at - t[0], 0.0), np.maximum(at - t[-1], 0.0)
    result: FloatArray = integral + before * values[0] + after * values[-1]
    return result


def _integral_of_steps(t: FloatArray, values: FloatArray, at: FloatArray) -> FloatArray:
    bounds = np.concatenate(([t[0] - typical_period(t)], t))
    total = np.concatenate(([0.0], np.cumsum(values * np.diff(bounds))))
    integral = np.interp(at, bounds, total)
    before, after = np.minimum(at - bounds[0], 0.0), np.maximum(at - t[-1], 0.0)
    result: FloatArray = integral + before * values[0] + after * values[-1]
    return result
