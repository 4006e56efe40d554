"""Parts of range errors: size, colour and what they follow, as their options state."""

import math
from dataclasses import replace

import numpy as np
import pytest

from navlearn.logs.synthetic.range_errors import (
    RangeErrors,
    carrier_to_noise,
    multipath,
    range_errors,
    systematic_error,
)
from navlearn.logs.synthetic.reflections import Reflections, reflections, runs
from navlearn.logs.synthetic.satellite_options import PRESETS, SatelliteOptions

NONE = replace(PRESETS["ideal"], cn0_zenith=45.0, cn0_horizon=45.0)
NAMES = tuple(f"G{n:02d}" for n in range(1, 61))
COUNT = 4000
SHAPE = (COUNT, len(NAMES))
HIGH = np.full(SHAPE, math.pi / 2.0)
CLEAR = Reflections(
    np.zeros(SHAPE, dtype=bool), np.zeros(SHAPE, dtype=bool), *(np.zeros(SHAPE) for _ in range(3))
)


def errors(
    options: SatelliteOptions,
    *,
    elevation: np.ndarray = HIGH,
    speed: float = 0.0,
    dt: float = 1.0,
    seed: int = 7,
) -> RangeErrors:
    cn0 = carrier_to_noise(NAMES, elevation, CLEAR.loss, dt, options=options, seed=seed)
    along = np.full(COUNT, speed)
    return range_errors(NAMES, elevation, cn0, along, CLEAR, dt, options=options, seed=seed)


def correlation(x: np.ndarray, lag: int) -> float:
    """Return the correlation over a lag of a process of known zero mean."""
    return float((x[lag:] * x[:-lag]).mean() / (x**2).mean())


def test_ideal_has_no_error() -> None:
    found = errors(NONE)
    assert not found.range().any()
    assert not found.rate.any()


@pytest.mark.parametrize("name", ["ionosphere", "orbit"])
def test_slow_parts_are_gauss_markov(name: str) -> None:
    asked = replace(NONE, **{name: 1.3, f"{name}_time": 50.0}, ionosphere_shared=0.0)
    part = getattr(errors(asked), name)
    size = 1.3 * (1.0 + 16.0 * 0.03**3 if name == "ionosphere" else 1.0)
    # 60 satellites × 4000 s / (2 × 50 s) independent values.
    assert part.std() == pytest.approx(size, rel=0.04)
    for lag in (25, 50, 100):
        assert correlation(part, lag) == pytest.approx(math.exp(-lag / 50.0), abs=0.05)
    np.testing.assert_array_equal(errors(asked).range(), part)


def test_satellites_share_what_the_option_says() -> None:
    asked = replace(NONE, ionosphere=1.0, ionosphere_time=2.0, ionosphere_shared=0.7)
    pairs = np.corrcoef(errors(asked).ionosphere.T)
    assert pairs[np.triu_indices(len(NAMES), 1)].mean() == pytest.approx(0.7, abs=0.05)
    together = errors(replace(NONE, troposphere=0.2, troposphere_time=2.0)).troposphere
    np.testing.assert_allclose(together, np.repeat(together[:, :1], len(NAMES), axis=1))
    assert together.std() == pytest.approx(0.2, rel=0.1)


def test_low_satellites_are_worse() -> None:
    asked = replace(NONE, ionosphere=1.0, troposphere=1.0, multipath=1.0, orbit=1.0)
    low = errors(asked, elevation=np.full(SHAPE, math.radians(10.0)))
    high = errors(asked)

    def ratio(name: str) -> float:
        return float(np.abs(getattr(low, name)).mean() / np.abs(getattr(high, name)).mean())

    # Thin shell at 350 km; plane atmosphere; plane ground.
    shell = 1.0 / math.sqrt(1.0 - (6371.0 / 6721.0 * math.cos(math.radians(10.0))) ** 2)
    assert ratio("ionosphere") == pytest.approx(shell, rel=0.06)
    assert ratio("troposphere") == pytest.approx(1.0 / math.sin(math.radians(10.0)), rel=0.05)
    assert ratio("multipath") == pytest.approx(1.0 / math.sin(math.radians(10.0)), rel=1e-6)
    assert ratio("orbit") == pytest.approx(1.0, rel=1e-6)


@pytest.mark.parametrize("speed", [0.0, 5.0, 20.0])
def test_multipath_is_quick_and_small_in_a_quick_car(speed: float) -> None:
    asked = replace(NONE, multipath=1.0, multipath_time=40.0, multipath_speed=5.0)
    part = errors(asked, speed=speed).multipath
    quick = 1.0 + speed / 5.0
    assert part.std() == pytest.approx(1.0 / math.sqrt(quick), rel=0.05)
    for lag in (4, 8, 40):
        assert correlation(part, lag) == pytest.approx(math.exp(-lag * quick / 40.0), abs=0.05)


def test_multipath_keeps_its_size_when_the_car_stops_and_goes() -> None:
    asked = replace(NONE, multipath=1.0)
    speed = np.where(np.arange(COUNT) % 100 < 50, 0.0, 20.0)
    part = multipath(NAMES, HIGH, speed, 1.0, options=asked, seed=1)
    for k in (10, 40, 51, 60, 99):
        quick = 1.0 + speed[k] / asked.multipath_speed
        assert (part[k::100] ** 2).mean() == pytest.approx(1.0 / quick, rel=0.15), k


def test_noise_is_white_and_doubles_for_6_db() -> None:
    asked = replace(NONE, thermal=0.4, rate_thermal=0.05)
    at_45 = errors(asked)
    weak = replace(asked, cn0_zenith=45.0 - 20.0 * math.log10(2.0))
    at_39 = errors(weak)
    for part, size in (("thermal", 0.4), ("rate", 0.05)):
        assert getattr(at_45, part).std() == pytest.approx(size, rel=0.01)
        assert abs(correlation(getattr(at_45, part), 1)) < 0.01
        np.testing.assert_allclose(getattr(at_39, part), 2.0 * getattr(at_45, part))


def test_cn0_goes_with_the_sine_and_fades() -> None:
    asked = replace(NONE, cn0_zenith=49.0, cn0_horizon=35.0, fading=2.0, fading_time=10.0)
    level = np.full(SHAPE, math.radians(30.0))
    found = carrier_to_noise(NAMES, level, np.full(SHAPE, 3.0), 1.0, options=asked, seed=2)
    assert found.mean() == pytest.approx(42.0 - 3.0, abs=0.1)
    assert found.std() == pytest.approx(2.0, rel=0.03)
    assert correlation(found - 39.0, 10) == pytest.approx(math.exp(-1.0), abs=0.03)


def test_the_systematic_error_is_the_stated_function() -> None:
    rng = np.random.default_rng(1)
    cn0, elevation = rng.normal(41.0, 4.0, (50, 2)), rng.uniform(0.2, 1.4, (50, 2))
    weights = np.array([math.exp(-j / 3.0) for j in range(11)])
    for k, s in ((30, 0), (10, 1), (49, 1)):
        past = [(cn0[k - j, s] - 40.0) / 5.0 for j in range(11)]
        u = float(np.dot(weights, past) / weights.sum())
        expected = 0.6 * u + 0.3 * u * u + 0.5 - math.sin(elevation[k, s])
        assert systematic_error(elevation, cn0)[k, s] == pytest.approx(expected)
    asked = replace(NONE, systematic=2.0, fading=3.0)
    found = errors(asked)
    assert found.range().std() > 0.5
    np.testing.assert_array_equal(found.range(), found.systematic)


def test_runs_of_flags() -> None:
    flags = np.array((True, False, True, True, False, True))
    assert runs(flags) == [(0, 1), (2, 4), (5, 6)]
    assert runs(np.zeros(3, dtype=bool)) == []


def test_episodes_come_as_often_and_last_as_long_as_stated() -> None:
    asked = replace(
        NONE,
        reflections_per_hour=30.0,
        reflection=20.0,
        reflection_shortest=4.0,
        reflection_longest=16.0,
        reflection_loss=8.0,
    )
    level, behind = np.zeros(SHAPE), np.zeros(SHAPE, dtype=bool)
    found = reflections(NAMES, level, behind, 1.0, options=asked, seed=5)
    assert not found.lost.any()
    whole = [run for i in range(60) for run in runs(found.present[:, i]) if run[1] < COUNT]
    spans = [end - begin for begin, end in whole]
    assert min(spans) >= 4
    assert len(spans) == pytest.approx(60 * COUNT / 3600.0 * 30.0, rel=0.1)
    # Log-uniform: the mean is (16 − 4) / ln 4; some run into each other.
    assert np.mean(spans) == pytest.approx(12.0 / math.log(4.0), rel=0.12)
    here = found.present
    assert found.detour[here].mean() == pytest.approx(20.0, rel=0.1)
    assert found.loss[here].mean() == pytest.approx(8.0, rel=0.05)
    assert (found.loss[here] >= 0.0).all()
    assert not found.detour[~here].any()
    assert not found.rate_share[~here].any()
    high = reflections(
        NAMES, np.full(SHAPE, math.radians(60.0)), behind, 1.0, options=asked, seed=5
    )
    assert high.present.mean() == pytest.approx(0.25 * here.mean(), rel=0.2)


def test_of_the_hidden_some_are_reflected() -> None:
    asked = replace(NONE, reflections_per_hour=20.0, canyon_reflected=0.4)
    behind = np.zeros(SHAPE, dtype=bool)
    behind[::40] = behind[1::40] = True
    found = reflections(NAMES, np.zeros(SHAPE), behind, 1.0, options=asked, seed=5)
    assert not (found.lost & found.present).any()
    assert (found.lost | found.present)[behind].all()
    assert not found.lost[~behind].any()
    assert found.present[behind].mean() == pytest.approx(0.4, abs=0.03)
    # One run, one detour.
    np.testing.assert_array_equal(found.detour[::40], found.detour[1::40])


def test_a_reflected_range_is_too_long_and_its_rate_wrong() -> None:
    asked = replace(NONE, reflections_per_hour=60.0, reflection_rate=0.1)
    hit = reflections(NAMES, np.zeros(SHAPE), CLEAR.lost, 1.0, options=asked, seed=5)
    speed = np.full(COUNT, 12.0)
    found = range_errors(NAMES, HIGH, np.full(SHAPE, 45.0), speed, hit, 1.0, options=asked, seed=5)
    np.testing.assert_array_equal(found.range(), hit.detour)
    assert found.rate[hit.present].std() == pytest.approx(1.2, rel=0.1)
    assert not found.rate[~hit.present].any()
