"""Simulated noise of known coefficients against what is read off its Allan deviation."""

import math

import numpy as np
import pytest
from numpy.typing import NDArray

from navlearn.errors import ConfigError, LogError, MissingExtraError
from navlearn.logs.allan import deviation
from navlearn.logs.allan.deviation import AllanCurve, allan_curve
from navlearn.logs.allan.terms import FLAT, noise_terms

Array = NDArray[np.float64]
RATE = 10.0


def white(count: int, n: float, rng: np.random.Generator) -> Array:
    return n * math.sqrt(RATE) * rng.normal(size=count)


def walk(count: int, k: float, rng: np.random.Generator) -> Array:
    return k / math.sqrt(RATE) * np.cumsum(rng.normal(size=count))


def flicker(count: int, b: float, rng: np.random.Generator) -> Array:
    """Return noise of two-sided spectral density b² / (2 π f)."""
    longer = 4 * count
    f = np.fft.rfftfreq(longer, 1.0 / RATE)
    density = np.zeros_like(f)
    density[1:] = b * b / (2.0 * np.pi * f[1:])
    spectrum = (rng.normal(size=f.size) + 1j * rng.normal(size=f.size)) * np.sqrt(
        density * RATE * longer / 2.0
    )
    return np.asarray(np.fft.irfft(spectrum, longer)[:count])


def exact_curve(variance: Array, tau: Array) -> AllanCurve:
    root = np.sqrt(variance)
    return AllanCurve(
        tau=tau,
        deviation=root,
        low=0.9 * root,
        high=1.1 * root,
        freedom=np.full_like(tau, 100.0),
        confidence=0.95,
    )


def test_allan_deviation_of_white_noise_falls_with_the_root_of_time() -> None:
    rng = np.random.default_rng(1)
    held = []
    for _ in range(20):
        curve = allan_curve(white(9_000, 2.0, rng), RATE)
        scale = np.sqrt(curve.tau)
        assert abs(curve.deviation[0] * scale[0] - 2.0) < 0.1
        held.append((curve.low * scale <= 2.0) & (curve.high * scale >= 2.0))
    assert 0.88 < np.mean(np.concatenate(held)) < 1.0


def test_allan_deviation_of_a_random_walk_rises_with_the_root_of_time() -> None:
    rng = np.random.default_rng(2)
    curve = allan_curve(walk(72_000, 0.5, rng), RATE)
    middle = (curve.tau > 1.0) & (curve.tau < 60.0)
    ratio = curve.deviation[middle] / (0.5 * np.sqrt(curve.tau[middle] / 3.0))
    assert np.abs(ratio - 1.0).max() < 0.25


def test_allan_deviation_equals_its_definition() -> None:
    rng = np.random.default_rng(3)
    values = rng.normal(size=400)
    curve = allan_curve(values, RATE)
    for tau, found in zip(curve.tau, curve.deviation, strict=True):
        m = round(tau * RATE)
        means = np.convolve(values, np.ones(m) / m, "valid")
        change = means[m:] - means[:-m]
        assert found == pytest.approx(math.sqrt(0.5 * np.mean(change**2)), rel=1e-9)


def test_terms_of_an_exact_curve_are_exact() -> None:
    tau = 2.0 ** (np.arange(40) / 2.0) / 100.0
    q, n, b, k = 0.002, 0.3, 0.05, 0.001
    variance = 3.0 * q**2 / tau**2 + n**2 / tau + FLAT * b**2 + k**2 * tau / 3.0
    found = noise_terms(exact_curve(variance, tau))
    assert found.white.value == pytest.approx(n, rel=1e-6)
    assert found.instability.value == pytest.approx(b, rel=1e-6)
    assert found.walk.value == pytest.approx(k, rel=1e-6)
    assert found.misfit == pytest.approx(1.0, abs=1e-6)
    assert not found.foreign
    assert found.least == pytest.approx(math.sqrt(variance.min()))


@pytest.mark.parametrize(
    ("n", "b", "k", "minutes", "name", "true"),
    [
        (1.0, 0.0, 0.0, 10, "white", 1.0),
        (1.0, 0.0, 0.02, 60, "white", 1.0),
        (1.0, 0.0, 0.05, 60, "walk", 0.05),
        (0.3, 0.3, 0.0, 240, "instability", 0.3),
    ],
)
def test_intervals_hold_the_truth(
    n: float, b: float, k: float, minutes: int, name: str, true: float
) -> None:
    rng = np.random.default_rng(4)
    count = int(minutes * 60 * RATE)
    held, shown = 0, []
    for _ in range(12):
        values = white(count, n, rng) + flicker(count, b, rng) + walk(count, k, rng)
        term = getattr(noise_terms(allan_curve(values, RATE)), name)
        held += term.low <= true <= term.high
        if term.shown:
            shown.append(term.value)
    assert held >= 9  # 0.2 % of fair draws of 12 at 95 % have fewer
    assert len(shown) >= 10
    assert np.mean(shown) == pytest.approx(true, rel=0.15)


def test_what_is_not_there_is_not_shown_but_bounded() -> None:
    rng = np.random.default_rng(5)
    found = noise_terms(allan_curve(white(36_000, 1.0, rng), RATE))
    assert not found.walk.shown
    assert found.walk.low == 0.0
    assert 0.0 < found.walk.high < 0.01


def test_wider_confidence_gives_wider_intervals() -> None:
    values = white(6_000, 1.0, np.random.default_rng(6))
    narrow, wide = (noise_terms(allan_curve(values, RATE, confidence=c)) for c in (0.68, 0.99))
    assert wide.white.low < narrow.white.low < narrow.white.high < wide.white.high


def test_a_vibration_shows_as_a_misfit() -> None:
    rng = np.random.default_rng(7)
    t = np.arange(36_000) / RATE
    shaken = white(t.size, 0.01, rng) + np.sin(2.0 * np.pi * 0.31 * t)
    found = noise_terms(allan_curve(shaken, RATE))
    assert found.foreign
    assert not 0.7 < found.misfit < 1.4


def test_bad_arguments_are_refused() -> None:
    with pytest.raises(ConfigError, match="confidence"):
        allan_curve(np.ones(100), RATE, confidence=95.0)
    with pytest.raises(LogError, match="5 samples"):
        allan_curve(np.arange(5.0), RATE)


def test_a_missing_package_is_named_with_its_remedy(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(__import__("sys").modules, "allantools", None)
    with pytest.raises(MissingExtraError, match=r"pip install 'navlearn\[tuning\]'"):
        deviation.allantools()
