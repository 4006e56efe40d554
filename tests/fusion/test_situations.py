"""Situations in which little is observed, and instants between odometer samples."""

import pytest
import torch

from navlearn.frames import enu_between, shift_geodetic
from navlearn.fusion.error_state import error_layout, initial_belief
from navlearn.fusion.loosely_coupled import LooselyCoupledEkf
from navlearn.fusion.measurements import Kind
from navlearn.fusion.options import EkfOptions
from navlearn.logs.resample import riss_timeline
from navlearn.logs.synthetic.simulate import simulate_drive
from navlearn.mechanization.options import RissOptions
from navlearn.mechanization.riss_parallel import riss_over_time
from navlearn.states import NavState


def steady(d, speed, seed=4):
    """Give a drive one speed, no turn, and fixes that go with it."""
    g = torch.Generator().manual_seed(seed)
    zero = torch.zeros_like(d.samples.speed)
    samples = d.samples._replace(
        speed=zero + speed, yaw_rate=zero, pitch=zero, roll=zero, stationary=zero + (speed == 0.0)
    )
    truth = riss_over_time(d.start, samples)
    at = [torch.gather(x, 1, d.timing.index) for x in truth]
    noise = torch.randn(3, *at[0].shape, generator=g, dtype=torch.float64)
    lat, lon, height = shift_geodetic(*at[:3], *noise)
    fixes = d.fixes._replace(lat=lat, lon=lon, height=height, v_e=at[4], v_n=at[5], v_u=at[6])
    return d._replace(samples=samples, fixes=fixes, truth=truth)


@pytest.mark.parametrize("method", ["exact", "fast"])
@pytest.mark.parametrize("speed", [0.0, 10.0])
@pytest.mark.parametrize("model", ["bias_scale", "shen2010", "shen2010_full"])
def test_a_car_that_stands_or_drives_straight_does_no_harm(make_drive, model, speed, method):
    d = steady(make_drive(seconds=200, rate=5), speed)
    options = EkfOptions(model=model)
    with torch.no_grad():
        belief = initial_belief(options, d.start)
        history = LooselyCoupledEkf(options)(belief, d.samples, d.fixes, d.timing, method=method)
    end, there = ([x[0, -1] for x in path[:3]] for path in (history.belief.state, d.truth))
    assert max(abs(float(x)) for x in enu_between(*end, *there)) < 2.0
    P = history.belief.covariance[0, -1]
    scale = P.diagonal().sqrt()
    assert float(torch.linalg.eigvalsh(P / (scale[:, None] * scale)).min()) > 0.0
    if speed == 0.0:
        known = belief.covariance[0].diagonal().sqrt()
        names = error_layout(options).names
        for name in set(names) & {"azimuth", "speed_scale", "acceleration_bias"}:
            k = names.index(name)
            assert float(scale[k]) > 0.99 * float(known[k])


@pytest.mark.parametrize(("fix_rate", "late"), [(1.0, 0.0), (0.7, 0.02)])
def test_velocity_is_foretold_for_the_instant_of_the_fix(fix_rate, late):
    ideal = simulate_drive(
        profile="town", grade="ideal", duration=300.0, seed=1, fix_rate_hz=fix_rate
    )
    line = riss_timeline(ideal.log, rate_hz=10.0, dims=2)
    truth = ideal.log.reference
    start = truth.iloc[int((truth["t"] - line.start_time).abs().argmin())]
    options = EkfOptions(mechanization=RissOptions(dimensions=2))
    names = ("lat", "lon", "height", "azimuth")
    state = NavState(*(torch.tensor(float(start[x]), dtype=torch.float64) for x in names))
    sure = {"azimuth": 1e-3, "gyro_bias": 1e-6, "speed_scale": 1e-5}
    with torch.no_grad():
        history = LooselyCoupledEkf(options)(
            initial_belief(options, state, sigmas=sure), line.samples, line.fixes, line.timing
        )
    rows = LooselyCoupledEkf(options).model.rows.of(Kind.VELOCITY)
    east, north = history.innovation[:, rows].unbind(-1)
    sine, cosine = torch.sin(history.belief.state.azimuth), torch.cos(history.belief.state.azimuth)
    along, across = east * sine + north * cosine, east * cosine - north * sine
    there = torch.isfinite(east)
    speed = line.samples.speed
    growth = 10.0 * (speed[history.end] - speed[(history.end - 1).clamp(min=0)])
    braking = there & (growth < -1.0)
    turning = there & (line.samples.yaw_rate[history.end].abs() > 0.1)
    assert int(braking.sum()) > 10
    assert int(turning.sum()) > 10
    assert float(line.timing.delay.abs().median()) >= late
    # half an interval of braking at 2 m/s² would be 0.1 m/s, of turning at 0.4 rad/s 0.2 m/s
    assert float(along[there].abs().max()) < 0.08
    assert float(along[braking].square().mean().sqrt()) < 0.012
    assert float(across[turning].abs().max()) < 0.01
