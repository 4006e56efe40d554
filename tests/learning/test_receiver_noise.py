"""Inflations and floors from errors of fixes that are written down here."""

import math

import pytest
import torch
from torch import Tensor

from navlearn.attitude import wrap_angle
from navlearn.frames import shift_geodetic
from navlearn.learning.receiver_noise import receiver_noise
from navlearn.learning.referenced_drive import ReferencedDrive
from navlearn.states import FixTiming, GnssFix, RissSample, Trajectory

COUNT = 4000


def normal(seed: int, count: int = COUNT) -> Tensor:
    return torch.randn(count, generator=torch.Generator().manual_seed(seed), dtype=torch.float64)


def coloured(seed: int, correlation: float) -> Tensor:
    """Return an autoregression of first order with unit variance."""
    white, values = normal(seed), [0.0]
    for w in (white * math.sqrt(1.0 - correlation**2)).tolist():
        values.append(correlation * values[-1] + w)
    return torch.tensor(values[1:], dtype=torch.float64)


def drive(
    east: Tensor,
    north: Tensor,
    told: Tensor,
    *,
    up: Tensor | None = None,
    told_up: Tensor | None = None,
    speed: tuple[Tensor, Tensor] | None = None,
    yaw_rate: float = 0.0,
    lever_arm: tuple[float, float, float] = (0.0, 0.0, 0.0),
    offset: tuple[float, float, float] = (0.0, 0.0, 0.0),
) -> ReferencedDrive:
    """Return a car that heads east and stays; its fixes are off by what is given."""
    count = len(east)
    zero = torch.zeros(count, dtype=torch.float64)
    up = zero if up is None else up
    v_e, v_n = (zero, zero) if speed is None else speed
    at = Trajectory(zero + 0.8, zero + 0.1, zero + 50.0, zero + math.pi / 2, zero, zero, zero)
    lat, lon, height = shift_geodetic(
        at.lat, at.lon, at.height, east + offset[0], north + offset[1], up + offset[2]
    )
    fixes = GnssFix(
        lat=lat,
        lon=lon,
        height=height,
        v_e=v_e,
        v_n=v_n,
        v_u=zero,
        std_e=told,
        std_n=told,
        std_u=told if told_up is None else told_up,
        std_v=zero + 0.1,
        has_position=zero + 1.0,
        has_velocity=zero + (0.0 if speed is None else 1.0),
    )
    samples = RissSample(zero + 1.0, zero + yaw_rate, *(zero for _ in range(6)))
    return ReferencedDrive(
        "made",
        samples,
        fixes,
        FixTiming(torch.arange(count), zero),
        at,
        at,
        lever_arm,
    )


def varied(seed: int) -> Tensor:
    return torch.exp(0.7 * normal(seed))


def test_factor_and_floor_are_told_apart_where_deviations_vary() -> None:
    told = varied(1)
    sigma = torch.sqrt((1.8 * told) ** 2 + 0.9**2)
    found = receiver_noise([drive(sigma * normal(2), sigma * normal(3), told)], lasting=False)
    assert found.noise["position_inflation"] == pytest.approx(1.8, rel=0.05)
    assert found.noise["position_floor"] == pytest.approx(0.9, rel=0.1)
    assert found.lasting["position"] == 1.0


def test_no_floor_is_never_negative() -> None:
    told = varied(4)
    found = receiver_noise([drive(0.5 * told * normal(5), 0.5 * told * normal(6), told)])
    assert found.noise["position_inflation"] == pytest.approx(0.5, rel=0.05)
    assert 0.0 <= found.noise["position_floor"] < 0.1


def test_errors_that_owe_nothing_to_the_deviations_are_a_floor() -> None:
    told = varied(7) * 1e-3
    found = receiver_noise([drive(2.0 * normal(8), 2.0 * normal(9), told)])
    assert found.noise["position_floor"] == pytest.approx(2.0, rel=0.05)


def test_with_a_constant_deviation_only_the_factor_is_told() -> None:
    told = torch.full((COUNT,), 2.0, dtype=torch.float64)
    found = receiver_noise([drive(3.0 * normal(10), 3.0 * normal(11), told)])
    assert found.noise["position_inflation"] == pytest.approx(1.5, rel=0.03)
    assert "position_floor" not in found.noise


def test_outliers_are_left_to_the_gate() -> None:
    told = torch.ones(COUNT, dtype=torch.float64)
    east = normal(12)
    east[::50] += 60.0
    found = receiver_noise([drive(east, normal(13), told)])
    assert found.noise["position_inflation"] == pytest.approx(1.0, rel=0.05)


@pytest.mark.parametrize("correlation", [0.5, 0.9])
def test_lasting_errors_count_for_as_little_as_they_say(correlation: float) -> None:
    told = torch.ones(COUNT, dtype=torch.float64)
    east, north = coloured(14, correlation), coloured(15, correlation)
    found = receiver_noise([drive(east, north, told)])
    # the sum of ρ^|k| over all lags
    expected = (1.0 + correlation) / (1.0 - correlation)
    assert found.lasting["position"] == pytest.approx(expected, rel=0.2)
    ratio = found.noise["position_inflation"] ** 2
    white = receiver_noise([drive(east, north, told)], lasting=False)
    assert ratio / white.noise["position_inflation"] ** 2 == pytest.approx(
        found.lasting["position"]
    )


def test_the_mean_of_many_lasting_errors_is_as_uncertain_as_told() -> None:
    """The factor is right if white noise of that variance makes means as uncertain."""
    told = torch.ones(COUNT, dtype=torch.float64)
    series = [coloured(20 + k, 0.8) for k in range(40)]
    found = receiver_noise([drive(series[0], series[1], told)])
    means = torch.stack([one.mean() for one in series])
    inflated = found.noise["position_inflation"] / math.sqrt(COUNT)
    assert float(means.std()) == pytest.approx(inflated, rel=0.3)


def test_gaps_between_fixes_do_not_break_the_correlation() -> None:
    told = torch.ones(COUNT, dtype=torch.float64)
    whole = drive(coloured(16, 0.8), coloured(17, 0.8), told)
    there = whole.fixes.has_position.clone()
    there[1000:1500] = 0.0
    holed = whole._replace(fixes=whole.fixes._replace(has_position=there))
    assert receiver_noise([holed]).lasting["position"] == pytest.approx(9.0, rel=0.25)


def test_velocity_and_height_have_their_own() -> None:
    told = torch.ones(COUNT, dtype=torch.float64)
    found = receiver_noise(
        [
            drive(
                normal(30),
                normal(31),
                told,
                up=5.0 * normal(32),
                told_up=3.0 * told,
                speed=(0.2 * normal(33), 0.2 * normal(34)),
            )
        ]
    )
    assert found.noise["velocity_inflation"] == pytest.approx(2.0, rel=0.05)
    assert found.noise["position_inflation"] == pytest.approx(1.0, rel=0.05)
    # what inflation · 3 m leaves of 5 m
    assert found.noise["height_floor"] == pytest.approx(4.0, rel=0.06)


def test_velocity_in_turns_is_not_judged() -> None:
    told = torch.ones(COUNT, dtype=torch.float64)
    off = torch.full((COUNT,), 9.0, dtype=torch.float64)
    turning = drive(normal(35), normal(36), told, speed=(off, off), yaw_rate=0.3)
    assert "velocity_inflation" not in receiver_noise([turning]).noise


def test_the_antenna_is_where_its_lever_arm_is() -> None:
    told = torch.ones(COUNT, dtype=torch.float64)
    # heading east: 2 m forward is east, 1 m to the right is south, 3 m up
    there = drive(normal(37), normal(38), told, lever_arm=(1.0, 2.0, 3.0), offset=(2.0, -1.0, 3.0))
    found = receiver_noise([there])
    assert found.noise["position_inflation"] == pytest.approx(1.0, rel=0.05)
    assert found.noise["height_floor"] == 0.0
    ignored = receiver_noise([there._replace(lever_arm=(0.0, 0.0, 0.0))])
    assert ignored.noise["position_inflation"] > 1.5


def test_a_receiver_that_tells_no_height_teaches_none() -> None:
    told = torch.ones(COUNT, dtype=torch.float64)
    found = receiver_noise([drive(normal(39), normal(40), told, told_up=1000.0 * told)])
    assert "height_floor" not in found.noise


def test_too_few_fixes_teach_nothing() -> None:
    few = torch.ones(10, dtype=torch.float64)
    assert receiver_noise([drive(few, few, few)]).noise == {}


def test_two_drives_teach_together() -> None:
    told = torch.ones(COUNT, dtype=torch.float64)
    near = drive(normal(41), normal(42), told)
    far = drive(2.0 * normal(43), 2.0 * normal(44), told)
    found = receiver_noise([near, far]).noise["position_inflation"]
    assert found == pytest.approx(math.sqrt(2.5), rel=0.05)


def test_at_the_antimeridian_errors_are_those_of_elsewhere() -> None:
    east, north, told = 2.0 * normal(1), 2.0 * normal(2), torch.ones(COUNT, dtype=torch.float64)
    inland = drive(east, north, told)
    # places just west of it, and fixes on either side
    west = inland.at_fixes.lon - 0.1 + math.pi - 1e-8
    lon = wrap_angle(inland.fixes.lon - 0.1 + west)
    there = inland._replace(
        at_fixes=inland.at_fixes._replace(lon=west), fixes=inland.fixes._replace(lon=lon)
    )
    assert float(lon.min()) < -3.0 < 3.0 < float(lon.max())
    expected = receiver_noise([inland], lasting=False).noise
    found = receiver_noise([there], lasting=False).noise
    assert found["position_inflation"] == pytest.approx(expected["position_inflation"], rel=1e-6)
