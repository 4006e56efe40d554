"""Three forms of one filter: the oracle sample by sample, the loop over blocks, all at once."""

import math

import pytest
import torch

from navlearn.errors import ConfigError, FilterDivergedError, LogError, ShapeError
from navlearn.frames import enu_between
from navlearn.fusion.error_state import initial_belief
from navlearn.fusion.gate_options import GateOptions
from navlearn.fusion.loosely_coupled import LooselyCoupledEkf
from navlearn.fusion.measurements import Kind, Verdict
from navlearn.fusion.noise_options import NoiseOptions
from navlearn.fusion.options import EkfOptions
from navlearn.fusion.sensor_errors import odometer_acceleration
from navlearn.mechanization.options import RissOptions
from navlearn.mechanization.riss_parallel import riss_over_time
from navlearn.states import FixTiming, GnssFix, RissSample

# a good gyro and odometer: how fast the forms agree depends on the noise, not on its defaults
STATED = NoiseOptions(
    turn_noise=0.01,
    gyro_bias_walk=math.radians(0.001),
    position_walk=0.05,
    position_inflation=1.0,
    speed_noise=0.05,
)


def stated(noise=STATED, **choices):
    return EkfOptions(noise=noise, **choices)


def run(options, d, method="exact"):
    with torch.no_grad():
        belief = initial_belief(options, d.start)
        return LooselyCoupledEkf(options)(belief, d.samples, d.fixes, d.timing, method=method)


def apart(a, b):
    """Largest distance between two trajectories or states, m."""
    return max(float(x.abs().max()) for x in enu_between(*a[:3], *b[:3]))


def relative(P, other):
    sigma = other.diagonal(dim1=-2, dim2=-1).sqrt()
    return float(((P - other).abs() / (sigma[..., None] * sigma[..., None, :])).max())


def row(d, b):
    one = {k: getattr(d, k) for k in d._fields}
    return type(d)(**{k: type(v)(*(x[b : b + 1] for x in v)) for k, v in one.items()})


VARIANTS = {
    "bias_scale": (stated(), 2e-5),
    "augmented": (
        stated(
            gyro_terms=("bias", "scale", "abs_scale", "quadratic", "f_x", "f_y"),
            speed_terms=("scale", "delay", "offset"),
        ),
        1e-3,
    ),
    "gauss_markov": (stated(correlation_time=100.0), 2e-4),
    "flat": (stated(mechanization=RissOptions(dimensions=2)), 2e-5),
    "bias_free": (stated(model="bias_free", velocity=False), 2e-5),
    "course": (stated(velocity=False, course=True, zero_speed=False), 2e-5),
    "open": (stated(feedback="open"), 5e-5),
    "lever": (stated(lever_arm=(0.4, -1.0, 1.5)), 2e-5),
    "shen2010": (stated(model="shen2010"), 1e-2),
    "shen2010_full": (stated(model="shen2010_full"), 1e-2),
}


@pytest.mark.parametrize("name", VARIANTS)
def test_blocks_equal_sample_by_sample_to_discretisation(make_drive, name):
    options, limit = VARIANTS[name]
    d = make_drive(seconds=20)
    d = d._replace(timing=d.timing._replace(delay=d.timing.delay + 0.02))
    exact, oracle = run(options, d), run(options, d, "sequential")
    assert apart(exact.trajectory, oracle.trajectory) < limit
    assert apart(exact.belief.state, oracle.belief.state) < limit
    assert relative(exact.belief.covariance, oracle.belief.covariance) < 20.0 * limit


def test_covariance_tends_to_the_oracle_with_the_sampling_interval(make_drive):
    gaps = []
    # what sensor parameters walk within a block is composed as if speed were steady there
    options = stated(
        noise=NoiseOptions(gyro_bias_walk=0.0, speed_scale_walk=0.0, pitch_bias_walk=0.0)
    )
    for rate in (5, 20):
        d = make_drive(seconds=20, rate=rate, gyro_random_walk=0.0)
        P = run(options, d).belief.covariance
        gaps.append(relative(P, run(options, d, "sequential").belief.covariance))
    assert gaps[1] < 0.5 * gaps[0]


@pytest.mark.parametrize("name", [k for k in VARIANTS if k != "open"])
def test_all_blocks_at_once_equal_the_loop(make_drive, name):
    options, _ = VARIANTS[name]
    d = make_drive(seconds=60, batch=2)
    exact, fast = run(options, d), run(options, d, "fast")
    assert fast.method == "fast"
    assert fast.passes <= 8
    assert torch.equal(exact.verdict, fast.verdict)
    # the Shen models converge by a factor of 5 a pass, the others by some 500
    limit = 5e-5 if options.has_velocity_states else 3e-5
    assert apart(exact.trajectory, fast.trajectory) < limit
    assert relative(fast.belief.covariance, exact.belief.covariance) < limit
    torch.testing.assert_close(fast.nis, exact.nis, atol=1e-4, rtol=1e-4, equal_nan=True)


def test_all_blocks_at_once_equal_the_loop_to_a_micrometre_over_outages(make_drive):
    d = make_drive(seconds=300)
    there = torch.ones_like(d.fixes.lat)
    there[:, 80:140] = 0.0
    there[:, 200:] = 0.0
    d = d._replace(fixes=d.fixes._replace(has_position=there, has_velocity=there))
    exact, fast = run(stated(), d), run(stated(), d, "fast")
    assert fast.method == "fast"
    assert apart(exact.belief.state, fast.belief.state) < 2e-6
    assert apart(exact.trajectory, fast.trajectory) < 2e-6


def test_the_filter_finds_what_was_wrong_with_the_sensors(make_drive):
    history = run(stated(), make_drive(seconds=300))
    bias, scale, pitch = history.belief.sensor[0, -1].tolist()
    sigma = history.belief.covariance[0, -1].diagonal().sqrt()[4:].tolist()
    for found, true, spread in zip((bias, scale, pitch), (0.002, 0.02, 0.01), sigma, strict=True):
        assert abs(found - true) < 4.0 * spread
    assert sigma[0] < 2e-4
    assert sigma[1] < 5e-3


def test_without_fixes_the_filter_is_the_mechanization(make_drive):
    d = make_drive(seconds=30)
    options = stated(zero_yaw_rate=False, zero_speed=False)
    none = GnssFix(*(x[:, :0] for x in d.fixes))
    d = d._replace(fixes=none, timing=FixTiming(*(x[:, :0] for x in d.timing)))
    expected = riss_over_time(d.start, d.samples)
    for method, limit in (("exact", 1e-5), ("fast", 1e-5), ("sequential", 1e-7)):
        assert apart(run(options, d, method).trajectory, expected) < limit


def test_batch_equals_one_by_one(make_drive):
    d = make_drive(seconds=30, batch=3)
    ragged = d.timing.index.clone()
    ragged[1, 10:] = -1
    d = d._replace(timing=d.timing._replace(index=ragged))
    for method in ("exact", "fast"):
        whole = run(stated(), d, method)
        for b in range(3):
            one = run(stated(), row(d, b), method)
            k = one.end.shape[1]
            assert apart([x[b] for x in whole.trajectory], [x[0] for x in one.trajectory]) < 1e-5
            last = int((whole.end[b] == one.end[0, -1]).nonzero()[0])
            assert (
                relative(whole.belief.covariance[b, last], one.belief.covariance[0, k - 1]) < 1e-5
            )


def test_unbatched_input_gives_unbatched_history(make_drive):
    d = make_drive(seconds=10)
    first = [type(part)(*(x[0] for x in part)) for part in d]
    single = run(stated(), type(d)(*first))
    assert single.trajectory.lat.shape == (200,)
    assert torch.equal(single.trajectory.lat, run(stated(), d).trajectory.lat[0])


def test_masked_fixes_equal_absent_ones(make_drive):
    d = make_drive(seconds=30)
    keep = torch.ones_like(d.fixes.lat)
    keep[:, 10:20] = 0.0
    masked = d._replace(fixes=d.fixes._replace(has_position=keep, has_velocity=keep))
    index = torch.where(keep > 0, d.timing.index, -1)
    absent = d._replace(timing=d.timing._replace(index=index))
    for method in ("exact", "fast"):
        a, b = run(stated(), masked, method), run(stated(), absent, method)
        assert apart(a.trajectory, b.trajectory) < 1e-6


@pytest.mark.parametrize("method", ["exact", "sequential"])
def test_a_poisoned_fix_changes_nothing_before_it(make_drive, method):
    d = make_drive(seconds=30)
    lat = d.fixes.lat.clone()
    lat[:, 20:] += 1e-2
    poisoned = d._replace(fixes=d.fixes._replace(lat=lat))
    a, b = run(stated(), d, method), run(stated(), poisoned, method)
    until = int(d.timing.index[0, 20])
    assert torch.equal(a.trajectory.lat[:, :until], b.trajectory.lat[:, :until])
    assert torch.equal(a.trajectory.azimuth[:, :until], b.trajectory.azimuth[:, :until])


def test_a_poisoned_fix_changes_nothing_before_it_in_the_fast_form(make_drive):
    d = make_drive(seconds=60)
    lat = d.fixes.lat.clone()
    lat[:, 40:] += 1e-2
    poisoned = d._replace(fixes=d.fixes._replace(lat=lat))
    a, b = run(stated(), d, "fast"), run(stated(), poisoned, "fast")
    until = int(d.timing.index[0, 40])
    before = [[x[:, :until] for x in h.trajectory] for h in (a, b)]
    assert apart(*before) < 2e-6


@pytest.mark.parametrize("method", ["exact", "fast"])
def test_the_gate_refuses_an_outlier(make_drive, method):
    d = make_drive(seconds=60)
    lat = d.fixes.lat.clone()
    lat[0, 30] += 50.0 / 6.37e6
    spoiled = run(stated(), d._replace(fixes=d.fixes._replace(lat=lat)), method)
    assert spoiled.method == method
    k = int((spoiled.fix[0] == 30).nonzero()[0])
    assert int(spoiled.verdict[0, k, Kind.POSITION]) == Verdict.REFUSED_BY_GATE
    assert int((spoiled.verdict == Verdict.REFUSED_BY_GATE).sum()) <= 2
    has = torch.ones_like(d.fixes.lat)
    has[0, 30] = 0.0
    without = run(stated(), d._replace(fixes=d.fixes._replace(has_position=has)), method)
    assert apart(spoiled.trajectory, without.trajectory) < 1e-5


@pytest.mark.parametrize("method", ["exact", "fast"])
def test_the_gate_resets_so_that_the_filter_cannot_lock_itself_out(make_drive, method):
    d = make_drive(seconds=80)
    lat = d.fixes.lat.clone()
    lat[0, 40:] += 200.0 / 6.37e6
    gate = GateOptions(reset_after=5)
    options = stated(velocity=False, gate=gate)
    history = run(options, d._replace(fixes=d.fixes._replace(lat=lat)), method)
    position = history.verdict[0, :, Kind.POSITION]
    first = int((history.fix[0] == 40).nonzero()[0])
    refused = position[first : first + 5].tolist()
    assert refused == [Verdict.REFUSED_BY_GATE] * 5
    assert int(position[first + 5]) == Verdict.ACCEPTED_BY_RESET
    assert int(history.resets[0, Kind.POSITION]) == 1
    end = [x[:, -1] for x in history.belief.state]
    there = [x[:, -1] for x in (lat, d.fixes.lon, d.fixes.height)]
    assert apart(end, there) < 8.0
    assert history.method == method


def test_covariance_stays_symmetric_and_positive(make_drive):
    d = make_drive(seconds=300, rate=5)
    options = stated(
        gyro_terms=("bias", "scale", "abs_scale"),
        noise=NoiseOptions(
            position_floor=0.01, velocity_floor=0.001, speed_noise=0.001, position_walk=0.0
        ),
    )
    for method in ("exact", "fast"):
        P = run(options, d, method).belief.covariance
        assert torch.equal(P, P.transpose(-1, -2))
        scale = P.diagonal(dim1=-2, dim2=-1).sqrt()
        correlation = P / (scale[..., None] * scale[..., None, :])
        assert float(torch.linalg.eigvalsh(correlation).min()) > 0.0


def test_streaming_equals_the_record(make_drive):
    d = make_drive(seconds=10, rate=10)
    options = stated(zero_yaw_rate=False)
    history = run(options, d, "sequential")
    filter_, belief = LooselyCoupledEkf(options), initial_belief(options, d.start)
    push = odometer_acceleration(d.samples.dt, d.samples.speed)
    with torch.no_grad():
        for k in range(100):
            sample = RissSample(*(x[:, k] for x in d.samples))
            belief = filter_.step(belief, sample)
            if (k + 1) % 10 == 0:
                fix = GnssFix(*(x[:, k // 10] for x in d.fixes))
                belief = filter_.update(belief, fix, sample, acceleration=push[:, k])
    assert apart(belief.state, [x[:, -1] for x in history.belief.state]) < 1e-9
    torch.testing.assert_close(belief.covariance, history.belief.covariance[:, -1])


def test_two_fixes_may_share_a_sample(make_drive):
    d = make_drive(seconds=20)
    twice = [torch.repeat_interleave(x, 2, dim=1) for x in d.fixes]
    fixes = GnssFix(*twice)
    first = torch.arange(fixes.lat.shape[1]) % 2 == 0
    fixes = fixes._replace(
        has_position=fixes.has_position * first, has_velocity=fixes.has_velocity * ~first
    )
    timing = FixTiming(*(torch.repeat_interleave(x, 2, dim=1) for x in d.timing))
    options = stated(gate=GateOptions(probability=1.0))
    split = run(options, d._replace(fixes=fixes, timing=timing))
    assert apart(split.trajectory, run(options, d).trajectory) < 0.05
    fast = run(options, d._replace(fixes=fixes, timing=timing), "fast")
    assert apart(split.trajectory, fast.trajectory) < 1e-5


def test_errors_name_what_is_wrong(make_drive):
    d = make_drive(seconds=5)
    options = stated()
    belief, ekf = initial_belief(options, d.start), LooselyCoupledEkf(options)
    with pytest.raises(ConfigError, match="exact, fast or sequential"):
        ekf(belief, d.samples, d.fixes, d.timing, method="quick")
    broken = d.samples.speed.clone()
    broken[0, 7] = torch.nan
    with pytest.raises(LogError, match=r"samples\.speed.*sample 7"):
        ekf(belief, d.samples._replace(speed=broken), d.fixes, d.timing)
    with pytest.raises(LogError, match=r"fixes\.lat"):
        ekf(belief, d.samples, d.fixes._replace(lat=d.fixes.lat * torch.inf), d.timing)
    with pytest.raises(LogError, match="sort the fixes"):
        ekf(belief, d.samples, d.fixes, d.timing._replace(index=d.timing.index.flip(1)))
    with pytest.raises(LogError, match=r"samples\.dt of drive 0 is -0\.05 s at sample 0"):
        ekf(belief, d.samples._replace(dt=-d.samples.dt), d.fixes, d.timing)
    with pytest.raises(LogError, match=r"timing\.delay of drive 0 is -0\.5 s at fix 0"):
        ekf(belief, d.samples, d.fixes, d.timing._replace(delay=d.timing.delay - 0.5))
    with pytest.raises(LogError, match=r"fixes\.std_n of drive 0 is 0 at fix 0"):
        ekf(belief, d.samples, d.fixes._replace(std_n=0.0 * d.fixes.std_n), d.timing)
    degrees = belief.state._replace(lon=torch.rad2deg(belief.state.lon))
    with pytest.raises(LogError, match=r"start\.state\.lon.*math\.radians"):
        ekf(belief._replace(state=degrees), d.samples, d.fixes, d.timing)
    with pytest.raises(ShapeError, match=r"start\.sensor"):
        ekf(belief._replace(sensor=belief.sensor[:, :1]), d.samples, d.fixes, d.timing)
    with pytest.raises(ShapeError, match="float64"):
        ekf(belief, d.samples._replace(speed=d.samples.speed.float()), d.fixes, d.timing)
    with pytest.raises(FilterDivergedError, match="variances"):
        ekf(belief._replace(covariance=-belief.covariance), d.samples, d.fixes, d.timing)
    with torch.no_grad():
        ekf.log_noise.fill_(torch.nan)
    with pytest.raises(FilterDivergedError, match=r"1\.00 s after its start"):
        ekf(belief, d.samples, d.fixes, d.timing)


def test_a_hopeless_filter_warns_in_the_same_words_each_time(make_drive):
    gate = GateOptions(reset_after=100)
    noise = NoiseOptions(position_inflation=0.0, position_floor=0.001)
    options = EkfOptions(gate=gate, noise=noise)
    said = []
    for seed in range(2):
        with pytest.warns(UserWarning, match="position") as told:
            run(options, make_drive(seconds=60, seed=seed))
        said.append([str(one.message) for one in told])
    assert said[0] == said[1]
    refusals, noise_too_small = said[0]
    assert "refused more than 50% of the measurements of kind position" in refusals
    assert "raise position_inflation, position_floor" in noise_too_small


def test_options_refuse_nonsense():
    with pytest.raises(ConfigError, match="gyro_terms"):
        EkfOptions(gyro_terms=("biass",))
    with pytest.raises(ConfigError, match="count twice"):
        EkfOptions(course=True)
    with pytest.raises(ConfigError, match="pitch_bias"):
        EkfOptions(pitch_bias=True, mechanization=RissOptions(dimensions=2))
    with pytest.raises(ConfigError, match="gyro_random_walk"):
        EkfOptions(noise=NoiseOptions(gyro_random_walk=-1.0))
