"""A simulated car drives like a car."""

import numpy as np
import pytest

from navlearn.errors import ConfigError
from navlearn.logs.synthetic.motion import Kinematics, Motion, uniform_spline
from navlearn.logs.synthetic.profile import PROFILES, draw_motion

DT = 0.02


def driven(profile: str, seed: int, duration: float = 1500.0) -> Kinematics:
    motion = draw_motion(profile, duration=duration, seed=seed)
    return motion.at(np.arange(0.0, duration, DT))


@pytest.fixture(scope="module")
def drives() -> dict[str, Kinematics]:
    return {profile: driven(profile, seed=11) for profile in PROFILES}


@pytest.mark.parametrize("profile", PROFILES)
def test_limits_of_a_road_car(drives: dict[str, Kinematics], profile: str) -> None:
    k = drives[profile]
    assert k.speed.min() == 0.0
    assert k.speed.max() < 45.0
    assert np.abs(k.acceleration).max() < 2.5
    assert np.abs(k.speed * k.azimuth_rate).max() < 3.0
    assert np.abs(np.diff(k.acceleration)).max() / DT < 9.0
    assert np.rad2deg(np.abs(k.pitch).max()) < 6.0
    assert np.rad2deg(np.abs(k.roll).max()) < 6.0
    assert np.rad2deg(np.abs(k.azimuth_rate).max()) < 60.0


@pytest.mark.parametrize("profile", PROFILES)
def test_rates_are_the_derivatives(drives: dict[str, Kinematics], profile: str) -> None:
    k = drives[profile]
    pairs = (
        (k.speed, k.acceleration),
        (k.azimuth, k.azimuth_rate),
        (k.pitch, k.pitch_rate),
        (k.roll, k.roll_rate),
    )
    for values, rate in pairs:
        central = (values[2:] - values[:-2]) / (2.0 * DT)
        assert np.abs(central - rate[1:-1]).max() < 1e-2 * np.abs(rate).max()
        assert np.abs(rate).max() > 0.0


@pytest.mark.parametrize("profile", PROFILES)
def test_a_standing_car_stands_still(drives: dict[str, Kinematics], profile: str) -> None:
    k = drives[profile]
    standing = k.speed == 0.0
    assert standing[: round(28.0 / DT)].all()
    for rate in (k.acceleration, k.azimuth_rate, k.pitch_rate, k.roll_rate):
        # Differences of equal spline coefficients leave rounding.
        assert np.abs(rate[standing]).max() < 1e-12


def test_profiles_differ_as_their_names_say(drives: dict[str, Kinematics]) -> None:
    stops = {
        name: int(np.sum(np.diff((k.speed == 0.0).astype(int)) == 1)) for name, k in drives.items()
    }
    mean = {name: float(k.speed.mean()) * 3.6 for name, k in drives.items()}
    turned = {
        name: float(np.rad2deg(np.abs(k.azimuth_rate).sum() * DT)) for name, k in drives.items()
    }
    assert stops["town"] >= 10
    assert stops["motorway"] == 0
    assert stops["mixed"] >= 5
    assert mean["town"] < mean["suburb"] < mean["motorway"]
    assert turned["town"] > 1000.0 > turned["motorway"]
    assert np.std(drives["hills"].pitch) > 1.5 * np.std(drives["town"].pitch)


def test_mixed_reaches_motorway_speed_and_stops_in_town_at_both_ends() -> None:
    k = driven("mixed", seed=3, duration=2400.0)
    third = k.speed.size // 3
    assert k.speed.max() * 3.6 > 95.0
    assert (k.speed[:third] == 0.0).any()
    assert (k.speed[-third:] == 0.0).any()


def test_the_road_ends_no_sooner_than_the_drive() -> None:
    for seed in range(4):
        for profile in ("motorway", "commute"):
            k = driven(profile, seed=seed, duration=600.0)
            assert np.isfinite(np.stack(k)).all()
            assert np.std(k.pitch[-1000:]) + k.speed[-1000:].max() > 0.0


def test_seeds_give_different_drives_and_the_same_seed_the_same() -> None:
    first, again, other = (driven("town", seed=s, duration=300.0) for s in (1, 1, 2))
    assert np.array_equal(np.stack(first), np.stack(again))
    assert not np.allclose(first.speed, other.speed)


def test_spline_stays_inside_its_command_and_keeps_constants() -> None:
    def command(x: np.ndarray) -> np.ndarray:
        return np.where(x < 5.0, 2.0, 7.0)

    spline = uniform_spline(command, 10.0, 0.5)
    x = np.linspace(0.0, 10.0, 2001)
    values = spline(x)
    assert values.min() >= 2.0 - 1e-12
    assert values.max() <= 7.0 + 1e-12
    assert values[x < 3.0] == pytest.approx(2.0, abs=1e-12)
    assert np.abs(spline.derivative()(x)).max() <= 5.0 / 0.5
    assert np.isfinite(spline.derivative(4)(x)).all()


def test_roll_leans_out_of_the_turn() -> None:
    flat = uniform_spline(np.zeros_like, 500.0, 10.0)
    left = Motion(
        duration=20.0,
        speed=uniform_spline(lambda t: np.full_like(t, 10.0), 20.0, 0.5),
        azimuth=uniform_spline(lambda t: -0.2 * t, 20.0, 0.5),
        slope=flat,
        crossfall=flat,
    )
    k = left.at(np.array([10.0]))
    assert k.azimuth_rate[0] == pytest.approx(-0.2)
    assert k.roll[0] == pytest.approx(0.008 * 10.0 * 0.2)


@pytest.mark.parametrize(
    ("profile", "duration", "standstill", "message"),
    [
        ("city", 100.0, 30.0, "expected one of town"),
        ("town", 20.0, 30.0, "longer than the standstill"),
        ("town", float("nan"), 30.0, "found nan"),
        ("town", 100.0, -1.0, "standstill of -1"),
    ],
)
def test_refusals(profile: str, duration: float, standstill: float, message: str) -> None:
    with pytest.raises(ConfigError, match=message):
        draw_motion(profile, duration=duration, seed=0, standstill=standstill)
