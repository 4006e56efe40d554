"""Mechanizing the inverse returns the trajectory, and inverting the mechanization the samples."""

import pytest
import torch

from navlearn.errors import ShapeError
from navlearn.mechanization import RissOptions, inverse_riss, riss_over_time

TOLERANCES = {"yaw_rate": 1e-11, "speed": 2e-7, "pitch": 1e-8, "roll": 1e-15, "dt": 0.0}


@pytest.mark.parametrize(
    "options",
    [
        RissOptions(),
        RissOptions(dimensions=2),
        RissOptions(tilt_compensation=False),
        RissOptions(earth_rate=False),
    ],
)
@pytest.mark.parametrize("dt", [0.01, 1.0])
def test_inverse_returns_the_input(drive, start, options, dt):
    samples, begin = drive(2, 600, dt), start(2)
    if not options.three_d:
        samples = samples._replace(pitch=samples.pitch * 0, roll=samples.roll * 0)
    # reversing, too
    samples = samples._replace(speed=samples.speed - 8.0)
    trajectory = riss_over_time(begin, samples, options=options)
    found = inverse_riss(begin, trajectory, samples.dt, samples.roll, options)
    still = samples.speed.abs() < 0.5  # pitch is not defined where nothing moves
    for name, tolerance in TOLERANCES.items():
        difference = (getattr(found, name) - getattr(samples, name)).abs()
        difference = difference[~still] if name == "pitch" else difference
        assert float(difference.max()) <= tolerance * (10.0 if dt < 0.1 else 1.0), name
    again = riss_over_time(begin, found, options=options)
    for a, b in zip(again[:4], trajectory[:4], strict=True):
        torch.testing.assert_close(a, b, rtol=0, atol=1e-11)


def test_standstill_and_padding_give_zeros(drive, start):
    samples, begin = drive(1, 10, 1.0), start(1)
    parked = samples._replace(speed=samples.speed * 0, stationary=torch.ones_like(samples.dt))
    options = RissOptions(hold_stationary=True)
    trajectory = riss_over_time(begin, parked, options=options)
    dt = torch.ones_like(samples.dt)
    dt[:, 7:] = 0.0
    found = inverse_riss(begin, trajectory, dt, options=options)
    assert torch.equal(found.speed, torch.zeros_like(dt))
    assert torch.equal(found.stationary, torch.ones_like(dt))
    assert torch.equal(found.yaw_rate[:, 7:], torch.zeros(1, 3, dtype=torch.float64))
    # a parked gyro senses the vertical Earth rate
    expected = 7.292115e-5 * torch.sin(begin.lat)
    torch.testing.assert_close(found.yaw_rate[:, 0], expected)


def test_wrong_dt_is_refused(drive, start):
    trajectory = riss_over_time(start(1), drive(1, 10))
    with pytest.raises(ShapeError, match=r"\(1, 9\)"):
        inverse_riss(start(1), trajectory, torch.ones(1, 9, dtype=torch.float64))
