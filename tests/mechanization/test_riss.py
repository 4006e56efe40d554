"""RISS sample by sample against closed forms, an ODE solver and the plain cases."""

import math

import pytest
import torch
from scipy import integrate

from navlearn import earth, wgs84
from navlearn.errors import ConfigError
from navlearn.mechanization import RissMechanization, RissOptions, riss_step
from navlearn.mechanization.motion import chord_over_arc
from navlearn.states import NavState, RissSample

ZERO = torch.zeros((), dtype=torch.float64)


def _state(lat: float, azimuth: float, height: float = 0.0) -> NavState:
    return NavState(*(torch.tensor(x, dtype=torch.float64) for x in (lat, 0.0, height, azimuth)))


def _sample(dt=1.0, yaw_rate=0.0, speed=0.0, pitch=0.0, roll=0.0, stationary=0.0) -> RissSample:
    values = (dt, yaw_rate, speed, pitch, roll, 0.0, 0.0, stationary)
    return RissSample(*(torch.as_tensor(x, dtype=torch.float64) for x in values))


def _run(state: NavState, sample: RissSample, steps: int, **options) -> NavState:
    for _ in range(steps):
        state = riss_step(state, sample, ZERO, ZERO, ZERO, **options)
    return state


def test_due_east_at_constant_azimuth_is_the_parallel():
    lat, height, speed, steps = 0.8, 200.0, 30.0, 600
    radius = float(earth.prime_vertical_radius(ZERO + lat)) + height
    # the gyro senses the Earth turning and the meridians converging
    yaw_rate = wgs84.EARTH_RATE * math.sin(lat) + speed * math.tan(lat) / radius
    end = _run(_state(lat, math.pi / 2, height), _sample(yaw_rate=yaw_rate, speed=speed), steps)
    assert (end.lat.item() - lat) * radius == pytest.approx(0.0, abs=1e-7)
    assert end.azimuth.item() == pytest.approx(math.pi / 2, abs=1e-12)
    expected = speed * steps / (radius * math.cos(lat))
    assert end.lon.item() == pytest.approx(expected, rel=1e-9)


def test_due_north_is_the_meridian_arc():
    state, way = _state(0.5, 0.0), 0.0
    for _ in range(300):
        ahead = state.lat + 50.0 / 6.36e6
        gyro = wgs84.EARTH_RATE * torch.sin(ahead)
        state = riss_step(state, _sample(dt=5.0, yaw_rate=gyro, speed=20.0), ZERO, ZERO, ZERO)
        way += 100.0
    arc, _ = integrate.quad(
        lambda x: float(earth.meridian_radius(ZERO + x)), 0.5, state.lat.item(), epsabs=1e-8
    )
    assert arc == pytest.approx(way, rel=2e-9)
    assert abs(state.lon.item()) * 5e6 < 1e-3


def test_a_car_that_never_steers_follows_a_geodesic():
    # Clairaut: R_N cos φ sin A is constant along a geodesic of the ellipsoid
    state = _state(0.9, 1.0)

    def clairaut(s: NavState) -> float:
        return float(earth.prime_vertical_radius(s.lat) * torch.cos(s.lat) * torch.sin(s.azimuth))

    before = clairaut(state)
    for _ in range(500):
        rate = 400.0 * torch.cos(state.azimuth) / earth.meridian_radius(state.lat)
        gyro = wgs84.EARTH_RATE * torch.sin(state.lat + 0.5 * rate)
        state = riss_step(state, _sample(yaw_rate=gyro, speed=400.0), ZERO, ZERO, ZERO)
    assert abs(state.azimuth.item() - 1.0) > 0.02
    assert clairaut(state) == pytest.approx(before, rel=1e-9)


def test_steps_follow_the_differential_equations_as_printed():
    # [Shen2010] Eqs. (1)-(3) with the tilt term, integrated to rounding by an 8th-order method
    yaw_rate, speed, pitch, roll = 0.05, 25.0, 0.05, -0.03

    def slope(_, x):
        lat, _, height, azimuth = (ZERO + v for v in x)
        v_e = speed * math.cos(pitch) * torch.sin(azimuth)
        v_n = speed * math.cos(pitch) * torch.cos(azimuth)
        r_m, r_n = earth.meridian_radius(lat) + height, earth.prime_vertical_radius(lat) + height
        turn = wgs84.EARTH_RATE * torch.sin(lat) + v_e * torch.tan(lat) / r_n
        turn = turn - yaw_rate / (math.cos(pitch) * math.cos(roll))
        return [v_n / r_m, v_e / (r_n * torch.cos(lat)), speed * math.sin(pitch), turn]

    truth = integrate.solve_ivp(
        slope, (0.0, 200.0), [1.0, 0.0, 10.0, 0.3], method="DOP853", rtol=1e-13, atol=1e-15
    ).y[:, -1]
    sample = _sample(dt=0.1, yaw_rate=yaw_rate, speed=speed, pitch=pitch, roll=roll)
    end = _run(_state(1.0, 0.3, 10.0), sample, 2000)
    assert abs(end.lat.item() - truth[0]) * 6.4e6 < 1e-4
    assert abs(end.lon.item() - truth[1]) * 3.5e6 < 1e-4
    assert end.height.item() == pytest.approx(truth[2], abs=1e-8)
    assert end.azimuth.item() == pytest.approx(truth[3], abs=1e-10)


@pytest.mark.parametrize("steps", [8, 100])
def test_a_circle_closes_and_has_the_radius_of_its_arc(steps):
    speed, radius = 10.0, 50.0
    dt = 2.0 * math.pi * radius / speed / steps
    sample = _sample(dt=dt, yaw_rate=speed / radius, speed=speed)
    half = _run(_state(0.0, math.pi / 2), sample, steps // 2, earth_rate=0.0)
    whole = _run(half, sample, steps // 2, earth_rate=0.0)
    across = half.lat.item() * float(earth.meridian_radius(ZERO))
    assert across == pytest.approx(2.0 * radius, abs=1e-5)
    assert abs(half.lon.item()) * 6.4e6 < 1e-5
    assert abs(whole.lat.item()) * 6.4e6 < 1e-5
    assert abs(whole.lon.item()) * 6.4e6 < 1e-5
    assert whole.azimuth.item() == pytest.approx(math.pi / 2 - 2.0 * math.pi, abs=1e-12)


def test_chord_of_an_arc():
    turn = torch.linspace(-math.pi, math.pi, 101, dtype=torch.float64)
    expected = torch.sinc(0.5 * turn / math.pi)
    torch.testing.assert_close(chord_over_arc(turn), expected, rtol=0, atol=3e-6)
    near = turn.abs() < 0.5
    torch.testing.assert_close(chord_over_arc(turn)[near], expected[near], rtol=0, atol=1e-12)


def test_zero_speed_holds_the_position_while_azimuth_feels_the_earth():
    begin = _state(0.6, 0.3, 55.0)
    end = _run(begin, _sample(), 100)
    assert (end.lat, end.lon, end.height) == (begin.lat, begin.lon, begin.height)
    drift = 100.0 * wgs84.EARTH_RATE * math.sin(0.6)
    assert end.azimuth.item() - 0.3 == pytest.approx(drift, rel=1e-11)


def test_hold_stationary_holds_all():
    begin = _state(0.6, 0.3, 55.0)
    parked = _sample(yaw_rate=0.01, speed=0.2, stationary=1.0)
    assert _run(begin, parked, 5, hold_stationary=True) == begin
    assert _run(begin, parked, 5).azimuth != begin.azimuth
    moving = RissMechanization(RissOptions(hold_stationary=True))
    samples = RissSample(*(x.reshape(1) for x in parked))
    assert moving(begin, samples, ZERO, ZERO, ZERO).v_n.item() == 0.0


def test_an_interval_of_no_length_moves_nothing():
    begin = _state(0.6, 0.3, 55.0)
    assert _run(begin, _sample(dt=0.0, yaw_rate=3.0, speed=9.0, pitch=0.1), 3) == begin


def test_a_turn_on_a_slope_needs_the_tilt_term():
    # a quarter turn in the plane of a 6° slope seen by a gyro normal to it
    slope, seconds = math.radians(6.0), 10
    sample = _sample(yaw_rate=-0.5 * math.pi * math.cos(slope) / seconds, pitch=slope)
    turned = _run(_state(0.0, 0.0), sample, seconds).azimuth.item()
    flat = _run(_state(0.0, 0.0), sample, seconds, tilt_compensation=False).azimuth.item()
    assert turned == pytest.approx(math.pi / 2, rel=1e-12)
    assert 1.0 - flat / turned == pytest.approx(0.0055, abs=0.0001)


def test_two_dimensions_take_pitch_and_roll_as_zero():
    begin = _state(0.6, 0.3, 55.0)
    tilted = _sample(yaw_rate=0.1, speed=20.0, pitch=0.1, roll=0.2)
    level = _sample(yaw_rate=0.1, speed=20.0)
    assert _run(begin, tilted, 3, three_d=False) == _run(begin, level, 3)


def test_sensor_errors_are_taken_off(drive, start):
    clean = drive(2, 40, 0.1)
    bias, scale, pitch = (
        torch.tensor(x, dtype=torch.float64) for x in ([0.01, -0.02], [0.03, -0.01], [0.02, 0.0])
    )
    dirty = clean._replace(
        yaw_rate=clean.yaw_rate + bias.unsqueeze(-1),
        speed=clean.speed * (1.0 + scale.unsqueeze(-1)),
        pitch=clean.pitch + pitch.unsqueeze(-1),
    )
    moving = RissMechanization()
    found, expected = (
        moving(start(2), dirty, bias, scale, pitch),
        moving(start(2), clean, ZERO, ZERO, ZERO),
    )
    for a, b in zip(found, expected, strict=True):
        torch.testing.assert_close(a, b, rtol=1e-14, atol=1e-12)


@pytest.mark.parametrize(
    "options",
    [
        RissOptions(),
        RissOptions(dimensions=2),
        RissOptions(tilt_compensation=False, earth_rate=False),
    ],
)
def test_scripting_streaming_and_batches_equal_the_eager_record(drive, start, options):
    records, length = 3, 25
    samples, begin = drive(records, length, 0.2), start(records)
    bias = 0.01 * torch.ones(records, length, dtype=torch.float64).cumsum(-1)
    scale, pitch = ZERO + 0.02, torch.full((records,), 0.01, dtype=torch.float64)
    eager = RissMechanization(options)
    scripted = torch.jit.script(eager)
    record = eager(begin, samples, bias, scale, pitch)
    for a, b in zip(scripted(begin, samples, bias, scale, pitch), record, strict=True):
        assert torch.equal(a, b)
    state = begin
    for k in range(length):
        sample = RissSample(*(x[:, k] for x in samples))
        state = scripted.step(state, sample, bias[:, k], scale, pitch)
        torch.testing.assert_close(
            torch.stack(state), torch.stack([x[:, k] for x in record[:4]]), rtol=0, atol=1e-13
        )
    for j in range(records):
        one = eager(
            NavState(*(x[j] for x in begin)),
            RissSample(*(x[j] for x in samples)),
            bias[j],
            scale,
            pitch[j],
        )
        for a, b in zip(one, record, strict=True):
            torch.testing.assert_close(a, b[j], rtol=0, atol=1e-12)


def test_velocities_are_the_means_of_the_moves(drive, start):
    samples, begin = drive(1, 30, 0.1), start(1)
    found = RissMechanization()(begin, samples, ZERO, ZERO, ZERO)
    d_lat = torch.diff(found.lat, prepend=begin.lat.unsqueeze(-1))
    mid = found.lat - 0.5 * d_lat
    height = 0.5 * (
        found.height + torch.cat((begin.height.unsqueeze(-1), found.height[:, :-1]), -1)
    )
    v_n = d_lat * (earth.meridian_radius(mid) + height) / 0.1
    torch.testing.assert_close(found.v_n, v_n, rtol=0, atol=1e-7)
    d_height = torch.diff(found.height, prepend=begin.height.unsqueeze(-1))
    torch.testing.assert_close(found.v_u, d_height / 0.1, rtol=0, atol=1e-10)


@pytest.mark.parametrize(
    ("wrong", "word"),
    [
        ({"dimensions": 4}, "choose 2 or 3"),
        ({"dimensions": 2, "tilt_compensation": True}, "dimensions=3"),
        ({"passes": 0}, "1 or more"),
        ({"gradient": "magic"}, "adjoint"),
    ],
)
def test_options_refuse_with_advice(wrong, word):
    with pytest.raises(ConfigError, match=word):
        RissOptions(**wrong)
