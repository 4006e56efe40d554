"""Noise of dead reckoning from a reference, against sensors whose errors are written down here."""

import math
from collections.abc import Callable

import pytest
import torch
from torch import Tensor

from navlearn.errors import FitError
from navlearn.fusion.noise_options import NoiseOptions
from navlearn.fusion.options import EkfOptions
from navlearn.learning.ghouneem2024 import riss_errors
from navlearn.learning.increment_noise import FoundNoise, increment_noise, over_drives
from navlearn.learning.reference_increments import reference_increments
from navlearn.learning.referenced_drive import ReferencedDrive
from navlearn.mechanization.options import RissOptions
from navlearn.mechanization.riss_parallel import riss_over_time
from navlearn.states import FixTiming, GnssFix, NavState, RissSample, Trajectory

DT = 0.1
FLAT = EkfOptions(mechanization=RissOptions(dimensions=2))
HILLY = EkfOptions(mechanization=RissOptions(dimensions=3))


def normal(count: int, seed: int) -> Tensor:
    return torch.randn(count, generator=torch.Generator().manual_seed(seed), dtype=torch.float64)


def true_samples(seconds: float, *, turns: bool = True, hills: float = 0.0) -> RissSample:
    """Return samples without error: 10 to 16 m/s, a turn of 10 s now and then."""
    t = torch.arange(round(seconds / DT), dtype=torch.float64) * DT
    zero = torch.zeros_like(t)
    turning = (t % 40.0 < 10.0) & (t > 20.0)
    side = torch.where(t % 80.0 < 40.0, 0.15, -0.15)
    return RissSample(
        dt=zero + DT,
        yaw_rate=torch.where(turning, side, zero) if turns else zero,
        speed=13.0 + 3.0 * torch.sin(t / 15.0),
        pitch=hills * torch.sin(t / 20.0),
        roll=zero,
        f_x=zero,
        f_y=zero,
        stationary=zero,
    )


def drive_of(true: RissSample, measured: RissSample, options: EkfOptions) -> ReferencedDrive:
    """Return a drive whose reference is what true samples make."""
    zero = torch.zeros((), dtype=torch.float64)
    start = NavState(zero + 0.77, zero - 1.33, zero + 100.0, zero + 0.4)
    ran = riss_over_time(start, true, options=options.mechanization)
    begin = Trajectory(*start, *(channel[0] for channel in ran[4:]))
    whole = Trajectory(*(torch.cat((a[None], b)) for a, b in zip(begin, ran, strict=True)))
    none = zero.expand(0)
    return ReferencedDrive(
        "made",
        measured,
        GnssFix(*(none for _ in GnssFix._fields)),
        FixTiming(none.to(torch.int64), none),
        whole,
        Trajectory(*(none for _ in Trajectory._fields)),
        (0.0, 0.0, 0.0),
    )


def noise_of(
    change: Callable[[RissSample], RissSample],
    options: EkfOptions = FLAT,
    *,
    seconds: float = 3600.0,
    turns: bool = True,
    hills: float = 0.0,
    span: float = 1.0,
) -> FoundNoise:
    true = true_samples(seconds, turns=turns, hills=hills)
    drive = drive_of(true, change(true), options)
    return increment_noise(reference_increments(drive, options, span), options)


def test_without_errors_increments_are_zero() -> None:
    true = true_samples(300.0)
    found = reference_increments(drive_of(true, true, FLAT), FLAT)
    assert len(found.way) == 300
    for error in (found.along, found.across, found.azimuth, found.up):
        assert float(error.abs().max()) < 1e-6
    assert float(found.way.sum()) == pytest.approx(float((true.speed * DT).sum()))


def test_known_errors_have_known_increments() -> None:
    true = true_samples(300.0, turns=False)
    bias, scale = 0.002, 0.01
    measured = true._replace(yaw_rate=true.yaw_rate + bias, speed=true.speed * (1.0 + scale))
    found = reference_increments(drive_of(true, measured, FLAT), FLAT, span=2.0)
    assert found.span == pytest.approx(2.0)
    torch.testing.assert_close(found.azimuth, torch.full((150,), -2.0 * bias).double())
    torch.testing.assert_close(found.along, found.way * scale / (1.0 + scale), rtol=1e-3, atol=1e-6)
    # a car that turns left ever faster ends left of where it should by b v t² / 2
    torch.testing.assert_close(found.across, -bias * found.way, rtol=0.02, atol=1e-3)


def test_an_increment_owes_nothing_to_earlier_errors() -> None:
    true = true_samples(400.0)
    spoilt = true.yaw_rate.clone()
    spoilt[:50] += 0.2  # a jump of 57° in the first five seconds
    drive = drive_of(true, true._replace(yaw_rate=spoilt), FLAT)
    found = reference_increments(drive, FLAT)
    assert float(found.across[6:].abs().max()) < 1e-6
    assert float(riss_errors(drive, FLAT).east[-1].abs()) > 100.0


def test_the_angle_random_walk_is_found() -> None:
    walk = math.radians(0.6) / 60.0
    found = noise_of(
        lambda s: s._replace(yaw_rate=s.yaw_rate + walk / math.sqrt(DT) * normal(len(s.dt), 1))
    )
    assert found.noise["gyro_random_walk"] == pytest.approx(walk, rel=0.05)


def test_a_drifting_bias_is_a_bias_walk_and_no_random_walk() -> None:
    walk, drift = 2e-4, 2e-5

    def drifting(samples: RissSample) -> RissSample:
        bias = drift * math.sqrt(DT) * torch.cumsum(normal(len(samples.dt), 2), 0)
        white = walk / math.sqrt(DT) * normal(len(samples.dt), 3)
        return samples._replace(yaw_rate=samples.yaw_rate + white + bias + 0.003)

    found = noise_of(drifting, seconds=7200.0)
    assert found.noise["gyro_random_walk"] == pytest.approx(walk, rel=0.05)
    assert found.noise["gyro_bias_walk"] == pytest.approx(drift, rel=0.4)


def test_a_scale_error_is_turn_noise_times_the_root_of_a_turn() -> None:
    error = 0.02
    found = noise_of(lambda s: s._replace(yaw_rate=(1.0 + error) * s.yaw_rate))
    # turns last 10 s: what is wrong in one is error · ω · 10 s, as noise of density (n ω)²
    assert found.noise["turn_noise"] == pytest.approx(error * math.sqrt(10.0), rel=0.15)
    assert found.noise["gyro_random_walk"] < 1e-5


def test_a_scale_error_that_is_a_state_is_taken_off() -> None:
    options = EkfOptions(gyro_terms=("bias", "scale"), mechanization=FLAT.mechanization)
    found = noise_of(lambda s: s._replace(yaw_rate=1.02 * s.yaw_rate + 0.001), options)
    assert found.parameters["gyro_scale"] == pytest.approx(0.02 / 1.02, rel=0.02)
    assert found.noise["turn_noise"] < 0.005


def test_a_bias_without_a_state_is_noise() -> None:
    options = EkfOptions(model="bias_free", mechanization=FLAT.mechanization)
    found = noise_of(lambda s: s._replace(yaw_rate=s.yaw_rate + 0.003), options)
    assert found.noise["gyro_random_walk"] == pytest.approx(0.003, rel=0.01)
    assert "gyro_bias_walk" not in found.noise


def test_odometer_noise_is_position_walk_and_speed_noise() -> None:
    sigma = 0.4  # per 0.1 s sample
    found = noise_of(lambda s: s._replace(speed=s.speed + sigma * normal(len(s.dt), 4)))
    along = sigma * math.sqrt(DT)  # m per √s, and nothing across
    assert found.noise["position_walk"] == pytest.approx(along / math.sqrt(2.0), rel=0.05)
    assert found.noise["speed_noise"] == pytest.approx(sigma, rel=0.05)


def test_a_constant_odometer_scale_is_a_parameter_and_no_noise() -> None:
    found = noise_of(lambda s: s._replace(speed=1.013 * s.speed))
    assert found.parameters["speed_scale"] == pytest.approx(0.013 / 1.013, rel=0.01)
    assert found.noise["position_walk"] < 1e-3
    assert found.noise["speed_noise"] < 1e-3


def test_a_wandering_odometer_scale_is_found() -> None:
    walk = 3e-4
    found = noise_of(
        lambda s: s._replace(
            speed=s.speed * (1.0 + walk * math.sqrt(DT) * torch.cumsum(normal(len(s.dt), 5), 0))
        ),
        seconds=7200.0,
    )
    assert found.noise["speed_scale_walk"] == pytest.approx(walk, rel=0.35)


def test_a_misaligned_reference_is_no_noise() -> None:
    true = true_samples(600.0)
    drive = drive_of(true, true, FLAT)
    turned = drive.reference._replace(azimuth=drive.reference.azimuth + 0.02)
    found = increment_noise(reference_increments(drive._replace(reference=turned), FLAT), FLAT)
    assert found.noise["position_walk"] < 0.01


def test_hills_are_a_walk_where_the_mechanization_is_level() -> None:
    true = true_samples(1200.0, hills=0.03)
    drive = drive_of(true, true._replace(pitch=torch.zeros_like(true.dt)), HILLY)
    found = increment_noise(reference_increments(drive, FLAT), FLAT)
    climb = 0.03 * 13.0 / math.sqrt(2.0)  # m/s, root mean square, for ten seconds each
    assert found.noise["hill_walk"] == pytest.approx(climb * math.sqrt(10.0), rel=0.15)
    assert "height_walk" not in found.noise


def test_pitch_errors_are_height_and_pitch_walks() -> None:
    found = noise_of(
        lambda s: s._replace(pitch=s.pitch + 0.004 + 0.02 * normal(len(s.dt), 6)),
        HILLY,
        hills=0.03,
    )
    # 13 m/s times 0.02 rad in every 0.1 s
    assert found.noise["height_walk"] == pytest.approx(13.2 * 0.02 * math.sqrt(DT), rel=0.1)
    assert found.parameters["pitch_bias"] == pytest.approx(0.004, rel=0.15)
    assert "hill_walk" not in found.noise


def test_without_a_pitch_state_its_bias_is_a_height_walk() -> None:
    options = EkfOptions(pitch_bias=False, mechanization=HILLY.mechanization)
    found = noise_of(lambda s: s._replace(pitch=s.pitch + 0.01), options, hills=0.03)
    assert found.noise["height_walk"] == pytest.approx(13.2 * 0.01, rel=0.05)
    assert "pitch_bias" not in found.parameters


@pytest.mark.parametrize("model", ["shen2010", "shen2010_full"])
def test_the_shen_models_have_velocity_walks_and_no_odometer_states(model: str) -> None:
    options = EkfOptions(model=model, mechanization=HILLY.mechanization)  # type: ignore[arg-type]
    sigma = 0.05
    found = noise_of(
        lambda s: s._replace(speed=s.speed + sigma * normal(len(s.dt), 7)), options, hills=0.03
    )
    # the difference of two samples, along; next to nothing across and up
    assert found.noise["velocity_walk"] == pytest.approx(sigma * math.sqrt(2.0 / 3.0), rel=0.1)
    assert found.parameters == {}
    assert "speed_scale_walk" not in found.noise
    assert "gyro_bias_walk" in found.noise


def test_every_entry_is_one_of_the_options() -> None:
    known = set(NoiseOptions.__dataclass_fields__)
    for options in (FLAT, HILLY, EkfOptions(model="shen2010")):
        found = noise_of(lambda s: s._replace(yaw_rate=s.yaw_rate + 1e-3), options)
        assert set(found.noise) <= known
        assert all(value >= 0.0 and math.isfinite(value) for value in found.noise.values())


def test_standing_does_not_dilute_noise() -> None:
    walk = 3e-4

    def stands(samples: RissSample, *, noisy: bool) -> RissSample:
        second = torch.arange(len(samples.dt)) * DT
        still = (second > 600.0) & (second < 2400.0)
        white = walk / math.sqrt(DT) * normal(len(samples.dt), 8)
        zero = torch.zeros_like(samples.dt)
        return samples._replace(
            speed=torch.where(still, zero, samples.speed),
            yaw_rate=torch.where(still, zero, samples.yaw_rate + (white if noisy else zero)),
            stationary=still.double(),
        )

    true = true_samples(3000.0)
    drive = drive_of(stands(true, noisy=False), stands(true, noisy=True), FLAT)
    found = increment_noise(reference_increments(drive, FLAT), FLAT)
    assert found.noise["gyro_random_walk"] == pytest.approx(walk, rel=0.08)


def test_a_reference_with_holes_is_used_where_it_is() -> None:
    true = true_samples(600.0)
    drive = drive_of(true, true, FLAT)
    holes = Trajectory(*(channel.clone() for channel in drive.reference))
    for channel in holes:
        channel[2000:3000] = torch.nan
    holes.height[:] = torch.nan
    found = reference_increments(drive._replace(reference=holes), FLAT)
    assert len(found.way) == 600 - 101
    assert bool(found.azimuth.isfinite().all())
    assert "hill_walk" not in increment_noise(found, FLAT).noise


def test_too_little_reference_is_refused() -> None:
    true = true_samples(40.0)
    with pytest.raises(FitError, match="40 stretches of 1 s"):
        reference_increments(drive_of(true, true, FLAT), FLAT)


def test_drives_enter_by_root_mean_squares_weighted_by_length() -> None:
    both = over_drives(
        [FoundNoise({"a": 1.0, "b": 5.0}, {}), FoundNoise({"a": 3.0}, {})], [100, 300]
    )
    assert both["a"] == pytest.approx(math.sqrt((100 + 300 * 9.0) / 400))
    assert both["b"] == 5.0
