"""The strapdown in local level against the truth of a simulated drive, and against itself."""

import torch

from navlearn import attitude
from navlearn.logs.synthetic import simulate_drive
from navlearn.mechanization.strapdown import strapdown_in_turn
from navlearn.mechanization.strapdown_parallel import strapdown_over_time
from navlearn.states import ImuSample, InsState


def _tensor(table, *columns) -> torch.Tensor:
    return torch.tensor(table[list(columns)].to_numpy(), dtype=torch.float64)


def ideal_drive(duration: float) -> tuple[InsState, ImuSample, InsState]:
    """Return start, error-free samples and truth at their ends, at 100 Hz."""
    log = simulate_drive(grade="ideal", duration=duration, seed=11, reference_rate_hz=100.0).log
    omega, force = (_tensor(log.imu, *(f"{n}_{a}" for a in "xyz")) for n in ("gyro", "accel"))
    zero = torch.zeros(len(omega), dtype=torch.float64)
    where = _tensor(log.reference, "lat", "lon", "height")
    v_l = _tensor(log.reference, "v_e", "v_n", "v_u")
    angles = _tensor(log.reference, "azimuth", "pitch", "roll")
    q_lb = attitude.quaternion_from_angles(*angles.unbind(-1))
    truth = InsState(*where.unbind(-1), v_l, q_lb)
    start = InsState(*(x[0] for x in truth))
    samples = ImuSample(zero + 0.01, omega, force, zero, zero, zero)
    return start, samples, InsState(*(x[1:] for x in truth))


def test_parallel_equals_in_turn():
    start, samples, _ = ideal_drive(60.0)
    samples = ImuSample(*(x[4000:5000] for x in samples))
    found, expected = strapdown_over_time(start, samples), strapdown_in_turn(start, samples)
    for a, b, metres in zip(found, expected, (6.4e6, 4.6e6, 1.0, 1.0, 1.0), strict=True):
        assert float((a - b).abs().max()) * metres < 1e-6


def test_ideal_sensors_drift_by_less_than_a_millimetre_in_ten_minutes():
    start, samples, truth = ideal_drive(600.0)
    found = strapdown_over_time(start, samples)
    sign = torch.sign((found.q_lb * truth.q_lb).sum(-1, keepdim=True))
    truth = truth._replace(q_lb=sign * truth.q_lb)
    for a, b, metres in zip(found, truth, (6.4e6, 4.6e6, 1.0, 1.0, 1.0), strict=True):
        assert float((a - b).abs().max()) * metres < 1e-3
