import numpy as np
import pytest
import torch

from navlearn.error_models.regressors import (
    CHANNELS,
    average_samples,
    build_regressors,
    forward_acceleration,
)
from navlearn.errors import ConfigError, ShapeError
from navlearn.states import RissSample


def drive(steps=40, seed=0):
    generator = torch.Generator().manual_seed(seed)
    fields = [torch.rand(2, steps, generator=generator).double() for _ in range(7)]
    stationary = (torch.rand(2, steps, generator=generator) > 0.3).double()
    fields[0] = 0.1 + 0.05 * fields[0]
    return RissSample(*fields, stationary)


def test_every_channel_against_numpy():
    sample = drive()
    dt, yaw, speed = (x.numpy() for x in (sample.dt, sample.yaw_rate, sample.speed))
    angle = np.cumsum(yaw * dt, -1)
    acceleration = np.zeros_like(speed)
    middle = np.cumsum(dt, -1) - dt / 2
    acceleration[:, 1:] = np.diff(speed, axis=-1) / np.diff(middle, axis=-1)
    expected = {
        "yaw_rate": yaw,
        "abs_yaw_rate": np.abs(yaw),
        "speed": speed,
        "acceleration": acceleration,
        "lateral_acceleration": speed * yaw,
        "f_x": sample.f_x.numpy(),
        "f_y": sample.f_y.numpy(),
        "pitch": sample.pitch.numpy(),
        "roll": sample.roll.numpy(),
        "stationary": sample.stationary.numpy(),
        "turned_angle": angle,
        "sin_turned_angle": np.sin(angle),
        "cos_turned_angle": np.cos(angle),
        "distance": np.cumsum(speed * dt, -1),
        "delay": np.cumsum(dt, -1) / 20.0,
    }
    assert set(expected) == set(CHANNELS)
    built = build_regressors(sample, CHANNELS, delay_scale=20.0)
    for k, name in enumerate(CHANNELS):
        np.testing.assert_allclose(built[..., k], expected[name], rtol=1e-12, err_msg=name)


def test_regressors_are_causal():
    sample = drive()
    changed = RissSample(*(torch.cat([x[:, :20], 5.0 + x[:, 20:]], -1) for x in sample))
    before = build_regressors(sample, CHANNELS)[:, :20]
    assert torch.equal(build_regressors(changed, CHANNELS)[:, :20], before)


def test_delay_counts_from_the_last_fix():
    sample = drive()
    since = torch.full_like(sample.dt, 3.0)
    assert torch.equal(build_regressors(sample, ("delay",), since_fix=since)[..., 0], since / 60)
    with pytest.raises(ShapeError, match="since_fix"):
        build_regressors(sample, ("delay",), since_fix=since[:, 1:])


def test_padding_gives_no_acceleration():
    speed = torch.tensor([1.0, 2.0, 9.0]).double()
    dt = torch.tensor([0.5, 0.5, 0.0]).double()
    assert forward_acceleration(speed, dt).tolist() == [0.0, 2.0, 0.0]


def test_unknown_names_are_refused():
    with pytest.raises(ConfigError, match="yawrate; choose from yaw_rate"):
        build_regressors(drive(), ("yawrate",))
    with pytest.raises(ConfigError, match="none named"):
        build_regressors(drive(), ())
    with pytest.raises(ConfigError, match="delay_scale"):
        build_regressors(drive(), ("delay",), delay_scale=0.0)


def test_block_means_keep_time_distance_and_turned_angle():
    sample = drive(steps=43)
    means = average_samples(sample, 10)
    assert means.dt.shape == (2, 4)
    for name in ("yaw_rate", "speed", "f_y"):
        fine, coarse = getattr(sample, name)[:, :40], getattr(means, name)
        torch.testing.assert_close(
            (fine * sample.dt[:, :40]).reshape(2, 4, 10).sum(-1), coarse * means.dt
        )
    whole = sample.stationary[:, :40].reshape(2, 4, 10).min(-1).values
    assert torch.equal(means.stationary, whole)
    with pytest.raises(ConfigError, match="block is 44"):
        average_samples(sample, 44)
