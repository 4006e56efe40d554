"""What the unscented filter shares with the extended one: doors, batches, gate, streaming."""

import math
from dataclasses import replace

import pytest
import torch

from navlearn.errors import ConfigError, FilterDivergedError, LogError, ShapeError
from navlearn.filters.belief import map_belief
from navlearn.filters.unscented import UnscentedOptions
from navlearn.fusion.error_state import initial_belief, position_difference
from navlearn.fusion.filters_of import riss_filter
from navlearn.fusion.gate_options import GateOptions
from navlearn.fusion.loosely_coupled import LooselyCoupledEkf
from navlearn.fusion.measurements import Kind, Verdict
from navlearn.fusion.noise_options import NoiseOptions
from navlearn.fusion.options import EkfOptions
from navlearn.fusion.sensor_errors import odometer_acceleration
from navlearn.fusion.unscented.loosely_coupled import LooselyCoupledUkf
from navlearn.navigator import Navigator, NavigatorOptions
from navlearn.states import GnssFix, NavState, RissSample

OPTIONS = EkfOptions(unscented=UnscentedOptions())


def run(options, d, method="exact", start=None):
    start = initial_belief(options, d.start) if start is None else start
    with torch.no_grad():
        return LooselyCoupledUkf(options)(start, d.samples, d.fixes, d.timing, method=method)


def test_options_choose_the_filter():
    assert isinstance(riss_filter(OPTIONS), LooselyCoupledUkf)
    assert isinstance(riss_filter(), LooselyCoupledEkf)
    assert isinstance(Navigator(NavigatorOptions(filter=OPTIONS)).filter, LooselyCoupledUkf)
    with pytest.raises(ConfigError, match="riss_filter"):
        LooselyCoupledEkf(OPTIONS)
    with pytest.raises(ConfigError, match="choose feedback closed"):
        riss_filter(replace(OPTIONS, feedback="open"))
    assert list(LooselyCoupledUkf(OPTIONS).state_dict()) == list(LooselyCoupledEkf().state_dict())


def test_bad_drives_are_refused_at_the_door(make_drive):
    d = make_drive(seconds=3, rate=4)
    with pytest.raises(ConfigError, match="choose exact, fast or sequential"):
        run(OPTIONS, d, "quick")
    for name, value in (("speed", math.nan), ("yaw_rate", math.inf)):
        channel = getattr(d.samples, name).clone()
        channel[0, 5] = value
        with pytest.raises(LogError, match=f"samples.{name} of drive 0"):
            run(OPTIONS, d._replace(samples=d.samples._replace(**{name: channel})))
    lat = d.fixes.lat.clone()
    lat[0, 1] = math.nan
    with pytest.raises(LogError, match=r"fixes\.lat"):
        run(OPTIONS, d._replace(fixes=d.fixes._replace(lat=lat)))
    wrong = d._replace(samples=RissSample(*(x.float() for x in d.samples)))
    with pytest.raises(ShapeError, match="float64"):
        run(OPTIONS, wrong)
    belief = initial_belief(OPTIONS, d.start)
    for value in (0.0, -1.0, math.nan):
        P = belief.covariance.clone()
        P[0, 4, 4] = value
        with pytest.raises(FilterDivergedError, match="start's variances"):
            run(OPTIONS, d, start=belief._replace(covariance=P))


def test_a_batch_is_its_drives_and_padding_moves_nothing(make_drive):
    d = make_drive(seconds=6, rate=5, batch=2)
    short = 17
    d.samples.dt[1, short:] = 0.0
    d.timing.index[1, short // 5 :] = -1
    for method in ("exact", "sequential"):
        both = run(OPTIONS, d, method)
        for b in range(2):
            length, fixes = (30, 6) if b == 0 else (short, short // 5)
            one = run(
                OPTIONS,
                d._replace(
                    start=NavState(*(x[b] for x in d.start)),
                    samples=RissSample(*(x[b, :length] for x in d.samples)),
                    fixes=GnssFix(*(x[b, :fixes] for x in d.fixes)),
                    timing=type(d.timing)(*(x[b, :fixes] for x in d.timing)),
                ),
                method,
            )
            K = len(one.end)
            assert one.innovation.dim() == 2
            for x, y in zip(both.belief.state, one.belief.state, strict=True):
                torch.testing.assert_close(x[b, :K], y, rtol=0.0, atol=1e-13)
            torch.testing.assert_close(
                both.belief.covariance[b, :K], one.belief.covariance, rtol=1e-9, atol=1e-14
            )
            for x, y in zip(both.trajectory, one.trajectory, strict=True):
                torch.testing.assert_close(x[b, : length - 1], y[:-1], rtol=0.0, atol=1e-9)
                # the mean's shift shows at a block's end, which padding puts off
                torch.testing.assert_close(x[b, length - 1], y[-1], rtol=0.0, atol=1e-4)


@pytest.mark.parametrize("model", ["bias_scale", "shen2010_full"])
def test_a_car_that_streams_is_the_oracle(make_drive, model):
    d = make_drive(seconds=4, rate=5)
    options = replace(OPTIONS, model=model, zero_yaw_rate=False, zero_speed=False)
    found, ukf = run(options, d, "sequential"), LooselyCoupledUkf(options)
    belief, k = initial_belief(options, d.start), 0
    push = odometer_acceleration(d.samples.dt, d.samples.speed)
    for j in range(d.samples.dt.shape[1]):
        sample = RissSample(*(x[:, j] for x in d.samples))
        belief = ukf.step(belief, sample, push[:, j])
        if j == int(d.timing.index[0, k]):
            fix = GnssFix(*(x[:, k] for x in d.fixes))
            belief, k = ukf.update(belief, fix, sample, acceleration=push[:, j]), k + 1
    last = map_belief(found.belief, lambda x: x[:, -1])
    close = 1e-6 if model == "bias_scale" else 0.1  # a velocity needs the sample before
    assert float(position_difference(belief.state, last.state).abs().max()) < close
    torch.testing.assert_close(belief.covariance, last.covariance, rtol=close * 10, atol=1e-9)


def test_the_gate_refuses_an_outlier_and_resets(make_drive):
    d = make_drive(seconds=10, rate=4)
    options = replace(OPTIONS, gate=GateOptions(reset_after=3))
    far = d.fixes.lat.clone()
    far[0, 3] += 100.0 / 6.4e6
    alone = run(options, d._replace(fixes=d.fixes._replace(lat=far)))
    codes = alone.verdict[0, :, Kind.POSITION].tolist()
    assert codes[3] == int(Verdict.REFUSED_BY_GATE)
    assert codes[:3] + codes[4:] == [int(Verdict.ACCEPTED)] * 9
    far[0, 3:] = d.fixes.lat[0, 3:] + 100.0 / 6.4e6
    moved = run(options, d._replace(fixes=d.fixes._replace(lat=far)))
    codes = moved.verdict[0, :, Kind.POSITION].tolist()
    assert codes[3:7] == [int(Verdict.REFUSED_BY_GATE)] * 3 + [int(Verdict.ACCEPTED_BY_RESET)]
    assert int(moved.resets[0, Kind.POSITION]) == 1
    north = position_difference(moved.belief.state, alone.belief.state)[0, -1, 1]
    assert float(north) == pytest.approx(100.0, abs=3.0)


def test_less_weight_and_thresholds_reach_the_points(make_drive):
    """Gate options act behind H, whoever made it: as in the extended filter."""
    d = make_drive(seconds=8, rate=4)
    lat = d.fixes.lat.clone()
    lat[0, 4] += 12.0 / 6.4e6
    d = d._replace(fixes=d.fixes._replace(lat=lat))
    for gate in (
        GateOptions(probability=1.0, robust="huber"),
        GateOptions(prediction_limit=8.0),
        GateOptions(motion_limit=8.0),
    ):
        options = replace(OPTIONS, gate=gate)
        found = run(options, d)
        plain = replace(options, unscented=None)
        with torch.no_grad():
            extended = riss_filter(plain)(
                initial_belief(plain, d.start), d.samples, d.fixes, d.timing
            )
        code = int(found.verdict[0, 4, Kind.POSITION])
        assert code not in (int(Verdict.ACCEPTED), int(Verdict.REFUSED_BY_GATE))
        assert torch.equal(found.verdict, extended.verdict)


def test_no_fixes_and_no_measurements_at_all(make_drive):
    d = make_drive(seconds=4, rate=4)
    none = d.fixes._replace(has_position=0 * d.fixes.lat, has_velocity=0 * d.fixes.lat)
    blind = replace(OPTIONS, zero_yaw_rate=False)
    found = run(blind, d._replace(fixes=none))
    assert bool(torch.isnan(found.innovation).all())
    empty = d._replace(
        fixes=GnssFix(*(x[:, :0] for x in d.fixes)),
        timing=type(d.timing)(*(x[:, :0] for x in d.timing)),
    )
    assert run(blind, empty).belief.covariance.shape == (1, 4, 7, 7)
    deaf = replace(blind, position=False, velocity=False)
    assert run(deaf, d).innovation.shape == (1, 4, 0)
    sigma = found.belief.covariance.diagonal(dim1=-2, dim2=-1)
    assert bool((sigma[:, 1:, 0] > sigma[:, :-1, 0]).all())


@pytest.mark.parametrize("method", ["exact", "sequential"])
def test_gradcheck_through_the_filter(make_drive, method):
    d = make_drive(seconds=3, rate=2)
    options = replace(OPTIONS, gate=GateOptions(probability=1.0))
    ukf, belief = LooselyCoupledUkf(options), initial_belief(options, d.start)

    def end(yaw_rate, speed, azimuth, log_noise):
        samples = d.samples._replace(yaw_rate=yaw_rate, speed=speed)
        begin = belief._replace(state=belief.state._replace(azimuth=azimuth))
        history = torch.func.functional_call(
            ukf, {"log_noise": log_noise}, (begin, samples, d.fixes, d.timing), {"method": method}
        )
        out = NavState(*(x[:, -1] for x in history.trajectory[:4]))
        east_north = position_difference(out, d.start)[..., :2]
        last = history.belief.covariance[:, -1].diagonal(dim1=-2, dim2=-1)
        return east_north, out.azimuth, last.log()

    inputs = (d.samples.yaw_rate, d.samples.speed, d.start.azimuth, ukf.log_noise.detach())
    inputs = tuple(x.clone().requires_grad_() for x in inputs)
    assert torch.autograd.gradcheck(end, inputs, eps=1e-4, atol=2e-4, rtol=1e-3, fast_mode=True)


def test_noise_of_zero_has_a_gradient(make_drive):
    """A walk of zero leaves Q without rank: its root must not divide by it."""
    d = make_drive(seconds=3, rate=4)
    options = replace(OPTIONS, noise=NoiseOptions(gyro_bias_walk=0.0, position_walk=0.0))
    ukf = LooselyCoupledUkf(options)
    ukf.log_noise.requires_grad_(True)
    history = ukf(initial_belief(options, d.start), d.samples, d.fixes, d.timing)
    (gradient,) = torch.autograd.grad(history.nis.nansum(), ukf.log_noise)
    assert bool(torch.isfinite(gradient).all())
    assert float(gradient[ukf.noise._fields.index("position_floor")]) < 0.0
