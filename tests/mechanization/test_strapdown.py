"""The strapdown in local level: closed forms, the truth of a simulated drive, its own limits."""

import math

import pytest
import torch

from navlearn import attitude, earth, wgs84
from navlearn.errors import ShapeError
from navlearn.logs.synthetic import simulate_drive
from navlearn.mechanization.strapdown import (
    local_level_in_turn,
    local_level_step,
    strapdown_in_turn,
)
from navlearn.mechanization.strapdown_ecef import from_ecef, strapdown_ecef_in_turn, to_ecef
from navlearn.mechanization.strapdown_parallel import local_level_over_time, strapdown_over_time
from navlearn.states import ImuSample, InsState

RADIUS = 6.38e6


def _tensor(table, *columns) -> torch.Tensor:
    return torch.tensor(table[list(columns)].to_numpy(), dtype=torch.float64)


def ideal_drive(duration: float, rate: float) -> tuple[InsState, ImuSample, InsState]:
    """Return start, error-free samples and truth at their ends."""
    log = simulate_drive(
        grade="ideal", duration=duration, seed=11, imu_rate_hz=rate, reference_rate_hz=rate
    ).log
    omega, force = (_tensor(log.imu, *(f"{n}_{a}" for a in "xyz")) for n in ("gyro", "accel"))
    zero = torch.zeros(len(omega), dtype=torch.float64)
    where = _tensor(log.reference, "lat", "lon", "height")
    v_l = _tensor(log.reference, "v_e", "v_n", "v_u")
    angles = _tensor(log.reference, "azimuth", "pitch", "roll")
    q_lb = attitude.quaternion_from_angles(*angles.unbind(-1))
    truth = InsState(*where.unbind(-1), v_l, q_lb)
    start = InsState(*(x[0] for x in truth))
    samples = ImuSample(zero + 1.0 / rate, omega, force, zero, zero, zero)
    return start, samples, InsState(*(x[1:] for x in truth))


def largest(found: InsState, expected: InsState) -> tuple[float, float, float]:
    """Return the largest differences of position (m), velocity (m/s) and attitude (rad)."""
    position = max(
        RADIUS * float((found.lat - expected.lat).abs().max()),
        RADIUS * float(((found.lon - expected.lon) * torch.cos(expected.lat)).abs().max()),
        float((found.height - expected.height).abs().max()),
    )
    sign = torch.sign((found.q_lb * expected.q_lb).sum(-1, keepdim=True))
    turn = 2.0 * (found.q_lb - sign * expected.q_lb).norm(dim=-1)
    return position, float((found.v_l - expected.v_l).abs().max()), float(turn.max())


def test_a_parked_car_stays_parked_for_half_an_hour(parked):
    start, samples = parked(18_000, 0.1)
    found = strapdown_over_time(start, samples)
    expected = InsState(*(x.unsqueeze(1).expand(4, 18_000, *x.shape[1:]) for x in start))
    position, velocity, turn = largest(found, expected)
    # what is left is the Earth's turn within an interval, squared, and the unstable height
    assert position < 2e-4
    assert velocity < 5e-7
    assert turn < 1e-10
    short = strapdown_in_turn(start, ImuSample(*(x[:, :100] for x in samples)))
    position, velocity, turn = largest(short, InsState(*(x[:, :100] for x in expected)))
    assert position < 1e-6
    assert velocity < 1e-9
    assert turn < 1e-12


def test_what_falls_is_carried_east_by_the_earth():
    lat, dt, count = torch.tensor(0.5, dtype=torch.float64), 0.01, 500
    upright = torch.tensor((1.0, 0.0, 0.0, 0.0), dtype=torch.float64)
    start = InsState(lat, 0.0 * lat, 0.0 * lat + 500.0, torch.zeros(3).double(), upright)
    nothing = torch.zeros(count, 3, dtype=torch.float64)
    found = local_level_in_turn(start, nothing, nothing, nothing[:, 0] + dt)
    t, g = dt * count, float(earth.normal_gravity(lat, start.height))
    radius = float(earth.prime_vertical_radius(lat)) + 500.0
    east = float(found.lon[-1]) * radius * math.cos(0.5)
    # higher terms in the turn of the Earth are 1e-4 of the first
    assert east == pytest.approx(wgs84.EARTH_RATE * g * t**3 * math.cos(0.5) / 3.0, rel=1e-3)
    assert float(found.height[-1]) == pytest.approx(500.0 - 0.5 * g * t**2, abs=5e-3)
    assert abs(float(found.lat[-1] - lat)) * RADIUS < 1e-3


def test_ideal_sensors_drift_by_a_millimetre_in_ten_minutes():
    start, samples, truth = ideal_drive(600.0, 100.0)
    position, velocity, turn = largest(strapdown_over_time(start, samples), truth)
    assert position < 3e-4
    assert velocity < 2e-6
    assert turn < 2e-9
    # without coning and sculling it is decimetres
    dt = samples.dt.unsqueeze(-1)
    plain = local_level_over_time(start, samples.omega_ib_b * dt, samples.f_b * dt, samples.dt)
    assert largest(plain, truth)[0] > 1e-2


@pytest.mark.slow
def test_both_frames_follow_the_truth_in_turn_for_ten_minutes_at_100_hz():
    start, samples, truth = ideal_drive(600.0, 100.0)
    with torch.no_grad():
        level = strapdown_in_turn(start, samples)
        ecef = from_ecef(strapdown_ecef_in_turn(to_ecef(start), samples))
    for found in (level, ecef):
        position, velocity, turn = largest(found, truth)
        assert position < 3e-4
        assert velocity < 2e-6
        assert turn < 2e-9
    assert largest(level, ecef)[0] < 1e-5


def test_both_frames_agree_over_ten_minutes(imu_drive, ins_start):
    start, samples = ins_start(2), imu_drive(2, 600, 1.0)
    with torch.no_grad():
        level = strapdown_in_turn(start, samples)
        ecef = strapdown_ecef_in_turn(to_ecef(start), samples)
        position, velocity, turn = largest(from_ecef(ecef), level)
    assert position < 1e-3
    assert velocity < 1e-5
    assert turn < 1e-9


def test_the_step_scripts_and_batches_equal_single_records(imu_drive, ins_start):
    start, samples = ins_start(3), imu_drive(3, 50)
    together = strapdown_in_turn(start, samples)
    for k in range(3):
        alone = strapdown_in_turn(
            InsState(*(x[k] for x in start)), ImuSample(*(x[k] for x in samples))
        )
        for a, b in zip(alone, together, strict=True):
            torch.testing.assert_close(a, b[k], rtol=1e-14, atol=1e-14)
    turn, push = samples.omega_ib_b[:, 0] * 0.01, samples.f_b[:, 0] * 0.01
    scripted = torch.jit.script(local_level_step)(start, turn, push, samples.dt[:, 0])
    eager = local_level_step(start, turn, push, samples.dt[:, 0])
    for a, b in zip(scripted, eager, strict=True):
        torch.testing.assert_close(a, b, rtol=0, atol=0)


def test_an_interval_of_no_length_moves_nothing(ins_start):
    start, nothing = ins_start(2), torch.zeros(2, 3, dtype=torch.float64)
    for a, b in zip(local_level_step(start, nothing, nothing, nothing[:, 0]), start, strict=True):
        torch.testing.assert_close(a, b, rtol=1e-15, atol=1e-15)


def test_step_passes_gradcheck(ins_start):
    start = ins_start(2)
    unit = 1e3 / RADIUS

    def step(lat, lon, *others):
        state = InsState(lat * unit, lon * unit, *others[:3])
        found = local_level_step(state, *others[3:])
        return found.lat / unit, found.lon / unit, found.height / 1e3, found.v_l, found.q_lb

    turn, push = torch.tensor(((0.03, -0.02, 0.1), (1.0, 0.5, 4.9))).double().unsqueeze(1).unbind(0)
    inputs = (
        start.lat / unit,
        start.lon / unit,
        *start[2:],
        turn.repeat(2, 1),
        push.repeat(2, 1),
        torch.tensor((0.5, 0.01), dtype=torch.float64),
    )
    inputs = tuple(x.clone().requires_grad_() for x in inputs)
    assert torch.autograd.gradcheck(step, inputs, eps=1e-5, atol=1e-6, rtol=1e-6)


def test_a_quaternion_that_is_not_quite_unit_becomes_so(imu_drive, ins_start):
    start, samples = ins_start(2), imu_drive(2, 400)
    start = start._replace(q_lb=start.q_lb * (1.0 + 1e-8))
    for found in (strapdown_in_turn(start, samples), strapdown_over_time(start, samples)):
        assert float((found.q_lb.norm(dim=-1) - 1.0).abs().max()) < 1e-14


@pytest.mark.parametrize("run", [strapdown_in_turn, strapdown_over_time])
def test_wrong_starts_are_refused_with_advice(imu_drive, ins_start, run):
    with pytest.raises(ShapeError, match=r"start.lat has shape \(3,\).*one start per record"):
        run(ins_start(3), imu_drive(2, 5))
    flat = ins_start(2)._replace(q_lb=ins_start(2).q_lb[0])
    with pytest.raises(ShapeError, match=r"start.q_lb has shape \(4,\).*expected \(2, 4\)"):
        run(flat, imu_drive(2, 5))
    with pytest.raises(ShapeError, match=r"float32.*\.double\(\)"):
        run(InsState(*(x.float() for x in ins_start(2))), imu_drive(2, 5))
    with pytest.raises(ShapeError, match=r"start.position has shape \(3, 3\)"):
        strapdown_ecef_in_turn(to_ecef(ins_start(3)), imu_drive(2, 5))


def _ecef(start: InsState, samples: ImuSample) -> InsState:
    return from_ecef(strapdown_ecef_in_turn(to_ecef(start), samples))


@pytest.mark.parametrize("run", [strapdown_in_turn, strapdown_over_time, _ecef])
def test_samples_in_float32_move_a_state_in_float64(imu_drive, ins_start, run):
    """Only the increments are rounded; a state in float32 would be rounded to decimetres."""
    coarse = ImuSample(*(x.float() for x in imu_drive(2, 500)))
    fine = ImuSample(*(x.double() for x in coarse))
    found, expected = run(ins_start(2), coarse), run(ins_start(2), fine)
    assert {x.dtype for x in found} == {torch.float64}
    position, velocity, angle = largest(found, expected)
    assert position < 5e-3
    assert velocity < 5e-4
    assert angle < 5e-6


@pytest.mark.parametrize("run", [strapdown_in_turn, strapdown_over_time, _ecef])
def test_a_record_without_samples_has_no_states(imu_drive, ins_start, run):
    nothing = ImuSample(*(x[:, :0] for x in imu_drive(2, 3)))
    found = run(ins_start(2), nothing)
    assert [tuple(x.shape) for x in found] == [(2, 0), (2, 0), (2, 0), (2, 0, 3), (2, 0, 4)]
    assert {x.dtype for x in found} == {torch.float64}
