"""The overlapping Allan deviation with intervals of confidence, by allantools.

[IEEE952] annex C. How many degrees of freedom an overlapping estimate has depends on the noise:
[Greenhall2003], as allantools computes it, with the noise read off the slope of the curve.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np

from navlearn.errors import ConfigError, LogError, MissingExtraError
from navlearn.logs.interval_means import FloatArray

PER_OCTAVE = 2
"""Averaging times per doubling."""

FEWEST_FREE = 2.0
"""An estimate with fewer degrees of freedom tells nothing."""


@dataclass(frozen=True, kw_only=True)
class AllanCurve:
    """Allan deviation of one axis, shape (J,) each.

    Attributes:
        tau: Averaging times, s, rising.
        deviation: Allan deviation, the axis's unit.
        low: Lower end of its interval of confidence.
        high: Upper end.
        freedom: Equivalent degrees of freedom.
        confidence: Share of intervals that hold the truth.
    """

    tau: FloatArray
    deviation: FloatArray
    low: FloatArray
    high: FloatArray
    freedom: FloatArray
    confidence: float


def allan_curve(values: FloatArray, rate_hz: float, *, confidence: float = 0.95) -> AllanCurve:
    """Return the Allan deviation of a sensor at rest.

    Args:
        values: What it read, evenly sampled, shape (N,).
        rate_hz: Samples per second.
        confidence: Share of intervals that shall hold the truth.

    Raises:
        ConfigError: The confidence is not a share.
        LogError: There are too few samples.
        MissingExtraError: allantools is not installed.
    """
    if not 0.5 < confidence < 1.0:
        raise ConfigError(f"confidence: found {confidence}; expected a share from 0.5 to 1")
    if values.size < 32:
        raise LogError(f"Allan deviation: {values.size} samples; expected 32 or more")
    tools = allantools()
    most = int(np.log2(values.size / 3) * PER_OCTAVE)
    factors = np.unique(np.rint(2.0 ** (np.arange(most + 1) / PER_OCTAVE)).astype(int))
    tau, deviation, _, _ = tools.oadev(
        values - values.mean(), rate=rate_hz, data_type="freq", taus=factors / rate_hz
    )
    factors = np.rint(tau * rate_hz).astype(int)
    freedom = np.array(
        [
            tools.edf_greenhall(
                alpha=int(alpha), d=2, m=int(m), N=values.size + 1, overlapping=True
            )
            for alpha, m in zip(_noise_exponents(tau, deviation), factors, strict=True)
        ]
    )
    kept = (freedom >= FEWEST_FREE) & (deviation > 0.0)
    if not kept.any():
        raise LogError("Allan deviation: no averaging time is told; give a longer stretch")
    ends = [
        tools.confidence_interval(d, f, ci=confidence)
        for d, f in zip(deviation[kept], freedom[kept], strict=True)
    ]
    low, high = (np.array([float(end[k]) for end in ends]) for k in (0, 1))
    return AllanCurve(
        tau=tau[kept],
        deviation=deviation[kept],
        low=low,
        high=high,
        freedom=freedom[kept],
        confidence=confidence,
    )


def allantools() -> Any:
    """Return the package that computes Allan deviations.

    Raises:
        MissingExtraError: It is not installed.
    """
    try:
        import allantools as found
    except ImportError as error:
        raise MissingExtraError(
            "Allan variances need allantools, which is not installed: pip install "
            "'navlearn[tuning]'"
        ) from error
    return found


def _noise_exponents(tau: FloatArray, deviation: FloatArray) -> FloatArray:
    """Return the exponent α of the noise's spectrum f^α at each time: slope of σ² is −α − 1.

    Never above white noise, 0: a curve of few degrees of freedom falls steeply by chance, and
    quantisation would lend it hundreds.
    """
    if tau.size < 2:
        return np.zeros(tau.size)
    slope = np.gradient(2.0 * np.log(np.maximum(deviation, 1e-300)), np.log(tau))
    exponents: FloatArray = np.clip(np.rint(-slope - 1.0), -2.0, 0.0)
    return exponents
