"""Smoothed drives: against the textbook recursion, through outages, and as good as they say."""

import sys

import numpy as np
import pytest
import torch

from navlearn.errors import ShapeError
from navlearn.filters.belief import Belief
from navlearn.filters.consistency import mean_band, nees
from navlearn.frames import enu_between, shift_geodetic
from navlearn.fusion.error_state import initial_belief, position_difference
from navlearn.fusion.gate_options import GateOptions
from navlearn.fusion.loosely_coupled import LooselyCoupledEkf
from navlearn.fusion.measurements import Kind, Verdict
from navlearn.fusion.noise_options import InitialOptions, NoiseOptions
from navlearn.fusion.options import EkfOptions
from navlearn.fusion.smoothing import SmoothedDrive, SmoothingOptions, smooth
from navlearn.mechanization.options import RissOptions
from navlearn.states import FixTiming, GnssFix, NavState

ONCE = SmoothingOptions(passes=1)

VARIANTS = {
    "bias_scale": EkfOptions(),
    "augmented": EkfOptions(
        gyro_terms=("bias", "scale", "abs_scale", "quadratic", "f_x", "f_y"),
        speed_terms=("scale", "delay", "offset"),
    ),
    "gauss_markov": EkfOptions(correlation_time=2000.0),
    "flat": EkfOptions(mechanization=RissOptions(dimensions=2)),
    "lever": EkfOptions(lever_arm=(0.4, -1.0, 1.5)),
    "bias_free": EkfOptions(model="bias_free"),
    "shen2010_full": EkfOptions(model="shen2010_full"),
}


def run(options, d, method="exact", smoothing=None):
    with torch.no_grad():
        ekf, belief = LooselyCoupledEkf(options), initial_belief(options, d.start)
        history = ekf(belief, d.samples, d.fixes, d.timing, method=method)
        found = smooth(ekf, belief, d.samples, d.fixes, d.timing, history, smoothing)
    return belief, history, found


def without_fixes(d, first, last):
    """Take the fixes of some seconds away."""
    seconds = torch.arange(d.timing.index.shape[1])
    keep = (seconds < first) | (seconds >= last)
    fixes = GnssFix(*(channel[:, keep] for channel in d.fixes))
    return d._replace(fixes=fixes, timing=FixTiming(*(x[:, keep] for x in d.timing)))


def horizontal(trajectory, truth):
    east, north, _ = enu_between(*trajectory[:3], *truth[:3])
    return torch.hypot(east, north)


def vector(options, belief, reference):
    """Belief minus another in error coordinates, models without velocity states."""
    position = position_difference(belief.state, reference.state)
    azimuth = (belief.state.azimuth - reference.state.azimuth).unsqueeze(-1)
    return torch.cat((position, azimuth, belief.sensor - reference.sensor), -1)


def textbook(options, start, history, transition) -> tuple[list[np.ndarray], list[np.ndarray]]:
    """Deviations of smoothed from filtered states, and covariances: the recursion as printed.

    The gain is P Φᵀ times the inverse of the covariance that the filter itself predicted, and
    the smoothed covariance the difference as printed: nothing of the process noise is known here.
    """
    prior, after = history.prior, history.belief
    moved = vector(options, after, prior)[0].numpy()
    filtered = [start.covariance[0].numpy(), *after.covariance[0].numpy()]
    deviation, P = np.zeros(moved.shape[-1]), filtered[-1]
    deviations, covariances = [deviation], [P]
    for k in reversed(range(moved.shape[0])):
        ahead = prior.covariance[0, k].numpy()
        cross = filtered[k] @ transition[0, k].numpy().T
        G = np.linalg.solve(ahead, cross.T).T
        deviation = G @ (deviation + moved[k])
        P = filtered[k] + G @ (P - ahead) @ G.T
        deviations.append(deviation)
        covariances.append(P)
    return deviations[::-1], covariances[::-1]


@pytest.mark.parametrize("name", [k for k in VARIANTS if not k.startswith("shen")])
def test_one_pass_is_the_textbook_recursion_over_the_filters_states(make_drive, name):
    options = VARIANTS[name]
    d = without_fixes(make_drive(seconds=60, rate=10), 25, 45)
    start, history, found = run(options, d, smoothing=ONCE)
    deviations, covariances = textbook(options, start, history, found.transition)
    for k, (expected, P) in enumerate(zip(deviations, covariances, strict=True)):
        filtered = start if k == 0 else at_block(history.belief, k - 1)
        smoothed = found.start if k == 0 else at_block(found.belief, k - 1)
        sigma = np.sqrt(np.diagonal(filtered.covariance[0].numpy()))
        got = vector(options, smoothed, filtered)[0].numpy()
        np.testing.assert_allclose(got / sigma, expected / sigma, atol=2e-6)
        unit = np.outer(sigma, sigma)
        np.testing.assert_allclose(smoothed.covariance[0].numpy() / unit, P / unit, atol=2e-6)


def at_block(belief: Belief, k: int) -> Belief:
    return Belief(NavState(*(x[:, k] for x in belief.state)), *(x[:, k] for x in belief[1:]))


@pytest.mark.parametrize("name", VARIANTS)
def test_smoothing_bridges_an_outage(make_drive, name):
    d = without_fixes(make_drive(seconds=200, rate=10, batch=4), 100, 130)
    options = VARIANTS[name]
    if name in ("bias_free", "shen2010_full"):
        d = without_fixes(make_drive(seconds=200, rate=10, batch=4, bias=0.0, scale=0.0), 100, 130)
    _, history, found = run(options, d, "fast")
    inside = slice(1000, 1300)
    truth = type(d.truth)(*(x[:, inside] for x in d.truth))
    before, after = (
        horizontal(type(d.truth)(*(x[:, inside] for x in path)), truth).amax(1)
        for path in (history.trajectory, found.trajectory)
    )
    assert float(after.mean()) < 0.6 * float(before.mean())
    assert bool(torch.isfinite(torch.stack(list(found.trajectory))).all())
    P = found.belief.covariance
    scale = history.belief.covariance.diagonal(dim1=-2, dim2=-1).sqrt()
    unit = scale.unsqueeze(-1) * scale.unsqueeze(-2)
    assert float(torch.linalg.eigvalsh(P / unit).min()) > -1e-13
    # velocity and azimuth, too, know now what came after
    turned = (found.trajectory.azimuth - d.truth.azimuth)[:, inside].abs().mean()
    assert float(turned) < float(
        (history.trajectory.azimuth - d.truth.azimuth)[:, inside].abs().mean()
    )


@pytest.mark.parametrize("method", ["exact", "sequential"])
def test_every_form_of_the_filter_smooths_alike(make_drive, method):
    d = without_fixes(make_drive(seconds=80, rate=10, batch=2), 30, 60)
    _, _, fast = run(EkfOptions(), d, "fast")
    _, _, other = run(EkfOptions(), d, method)
    assert float(horizontal(other.trajectory, fast.trajectory).max()) < 1e-4
    torch.testing.assert_close(
        other.belief.covariance, fast.belief.covariance, rtol=1e-5, atol=1e-12
    )


def test_the_last_belief_is_the_filters(make_drive):
    d = make_drive(seconds=60, rate=10)
    _, history, found = run(EkfOptions(), d, smoothing=ONCE)
    last, filtered = at_block(found.belief, -1), at_block(history.belief, -1)
    for a, b in zip((*last.state, last.sensor), (*filtered.state, filtered.sensor), strict=True):
        torch.testing.assert_close(a, b, rtol=0.0, atol=1e-9)
    torch.testing.assert_close(last.covariance, filtered.covariance, rtol=1e-9, atol=1e-15)


@pytest.mark.parametrize("model", ["bias_scale", "shen2010_full"])
def test_the_path_has_no_jumps_and_ends_blocks_where_the_beliefs_are(make_drive, model):
    d = without_fixes(make_drive(seconds=100, rate=10), 40, 70)
    _, history, found = run(EkfOptions(model=model), d)

    def jump(path):
        """Largest way in an interval beyond what velocity says."""
        lat, lon, height = (x[0] for x in path[:3])
        way = enu_between(lat[1:], lon[1:], height[1:], lat[:-1], lon[:-1], height[:-1])
        v_e, v_n = 0.1 * path.v_e[0, 1:], 0.1 * path.v_n[0, 1:]
        return float(torch.hypot(way[0] - v_e, way[1] - v_n).max())

    # a step of the filter's noise is spread over its second
    assert jump(found.trajectory) < 0.05
    assert jump(history.trajectory) > 0.5
    turn = torch.diff(found.trajectory.azimuth[0]) + 0.1 * d.samples.yaw_rate[0, 1:]
    assert float(turn.abs().max()) < 1e-3
    for path, state in zip(found.trajectory[:4], found.belief.state, strict=True):
        assert torch.equal(torch.gather(path, 1, found.end), state)


def test_the_car_stays_where_it_stands(make_drive):
    d = make_drive(seconds=100, rate=10)
    _, _, found = run(EkfOptions(), d)
    still = (d.samples.stationary[0] > 0.5).nonzero().flatten()
    held = still[1:][torch.diff(still) == 1]
    moved = enu_between(
        *(x[0, held] for x in found.trajectory[:3]), *(x[0, held - 1] for x in found.trajectory[:3])
    )
    assert held.numel() > 100
    # but for what one block of the smoother's noise is off by: 1e-9 of it falls on standing
    assert max(float(x.abs().max()) for x in moved) < 1e-6


def test_iterating_undoes_what_a_large_drift_bends(make_drive):
    """A known start, an unknown bias that turns the car by 35°, then fixes: 1.4 km without one."""
    d = make_drive(
        seconds=240, rate=10, bias=0.005, scale=0.0, pitch_bias=0.0, gyro_random_walk=0.0
    )
    d = without_fixes(d, 0, 120)
    options = EkfOptions(
        initial=InitialOptions(position=0.1, azimuth=0.002, gyro={"bias": 0.005}),
        gate=GateOptions(probability=1.0),
        noise=NoiseOptions(turn_noise=0.003, position_walk=0.02, gyro_random_walk=1e-5),
        zero_yaw_rate=False,
    )
    _, history, once = run(options, d, smoothing=ONCE)
    _, _, often = run(options, d)
    drift, bent, undone = (
        float(horizontal(one.trajectory, d.truth)[:, :1200].max()) for one in (history, once, often)
    )
    assert drift > 200.0
    assert undone < 0.2 * bent
    assert undone < 3.0
    assert 2 < often.passes < 10


def test_what_the_gate_refused_stays_refused(make_drive):
    d = make_drive(seconds=60, rate=10)
    lat, zero = d.fixes.lat.clone(), d.fixes.has_position.clone()
    lat[:, 30] += 1e-3
    zero[:, 30] = 0.0
    _, history, found = run(EkfOptions(), d._replace(fixes=d.fixes._replace(lat=lat)))
    assert int(history.verdict[0, 30, Kind.POSITION]) == Verdict.REFUSED_BY_GATE
    _, _, absent = run(EkfOptions(), d._replace(fixes=d.fixes._replace(has_position=zero)))
    assert float(horizontal(found.trajectory, absent.trajectory).max()) < 1e-9
    assert torch.equal(found.belief.covariance, absent.belief.covariance)


def test_a_reset_passes_no_certainty_across(make_drive):
    """GNSS moves by 400 m for good: the filter follows after five refusals, the past does not."""
    d = make_drive(seconds=120, rate=10)
    away = (torch.arange(120) >= 60).to(d.fixes.lat) * 400.0
    lat, lon, height = shift_geodetic(*d.fixes[:3], away, 0.0 * away, 0.0 * away)
    moved = d._replace(fixes=d.fixes._replace(lat=lat, lon=lon, height=height))
    options = EkfOptions(gate=GateOptions(reset_after=5))
    for method in ("exact", "fast"):
        _, history, found = run(options, moved, method)
        assert history.resets[0, Kind.POSITION] == 1
        short = d._replace(
            samples=type(d.samples)(*(x[:, :600] for x in d.samples)),
            fixes=GnssFix(*(x[:, :60] for x in d.fixes)),
            timing=FixTiming(*(x[:, :60] for x in d.timing)),
        )
        _, _, alone = run(options, short, method)
        past = type(d.truth)(*(x[:, :590] for x in found.trajectory))
        known = type(d.truth)(*(x[:, :590] for x in alone.trajectory))
        assert float(horizontal(past, known).max()) < 3.0
        after = type(d.truth)(*(x[:, 700:] for x in found.trajectory))
        truth = type(d.truth)(*(x[:, 700:] for x in d.truth))
        assert float((horizontal(after, truth) - 400.0).abs().max()) < 10.0
        sure, unsure = (one.belief.covariance[0, 58, :2, :2] for one in (found, alone))
        assert float(sure.diagonal().sum()) > 0.5 * float(unsure.diagonal().sum())


def test_batches_equal_single_drives_and_fixes_may_be_missing(make_drive):
    d = make_drive(seconds=40, rate=10, batch=2)
    index = d.timing.index.clone()
    index[1] = -1  # the second drive has no fix at all
    d = d._replace(timing=d.timing._replace(index=index))
    belief, _, found = run(EkfOptions(), d, smoothing=ONCE)
    ekf = LooselyCoupledEkf(EkfOptions())
    for b in range(2):
        one = Belief(NavState(*(x[b] for x in belief.state)), *(x[b] for x in belief[1:]))
        samples = type(d.samples)(*(x[b] for x in d.samples))
        fixes, timing = GnssFix(*(x[b] for x in d.fixes)), FixTiming(*(x[b] for x in d.timing))
        with torch.no_grad():
            alone = ekf(one, samples, fixes, timing)
            single = smooth(ekf, one, samples, fixes, timing, alone, ONCE)
        assert single.belief.covariance.dim() == 3
        for a, b_ in zip(single.trajectory, found.trajectory, strict=True):
            torch.testing.assert_close(a, b_[b], rtol=0.0, atol=1e-9)


def test_a_drive_without_any_fix_can_be_smoothed(make_drive):
    d = without_fixes(make_drive(seconds=60, rate=10), 0, 60)
    _, history, found = run(EkfOptions(), d)
    bias = history.belief.sensor[0, :, 0], found.belief.sensor[0, :, 0]
    # standing after 21 s tells the bias; the smoother knows it from the first second
    assert abs(float(bias[1][0]) - 0.002) < 0.1 * abs(float(bias[0][0]) - 0.002)


def test_smoothing_has_the_gradient_of_finite_differences(make_drive):
    d = make_drive(seconds=4, rate=2)
    options = EkfOptions(gate=GateOptions(probability=1.0))
    ekf, start = LooselyCoupledEkf(options), initial_belief(options, d.start)

    def smoothed(yaw_rate, v_e, log_noise):
        samples, fixes = d.samples._replace(yaw_rate=yaw_rate), d.fixes._replace(v_e=v_e)
        with torch.no_grad():
            history = ekf(start, d.samples, d.fixes, d.timing)

        def of(filter_):
            return smooth(
                filter_, start, samples, fixes, d.timing, history, SmoothingOptions(passes=8)
            )

        found = torch.func.functional_call(_Caller(ekf, of), {"ekf.log_noise": log_noise}, ())
        out = NavState(*(x[:, 1] for x in found.trajectory[:4]))
        spread = found.belief.covariance.diagonal(dim1=-2, dim2=-1).log()
        return position_difference(out, d.start)[..., :2], out.azimuth, spread

    inputs = (d.samples.yaw_rate, d.fixes.v_e, ekf.log_noise.detach())
    inputs = tuple(x.clone().requires_grad_() for x in inputs)
    assert torch.autograd.gradcheck(
        smoothed, inputs, eps=1e-4, atol=1e-3, rtol=3e-3, fast_mode=True
    )


class _Caller(torch.nn.Module):
    def __init__(self, ekf, function):
        super().__init__()
        self.ekf, self.function = ekf, function

    def forward(self) -> SmoothedDrive:
        return self.function(self.ekf)


def test_a_history_of_other_data_is_refused(make_drive):
    d = make_drive(seconds=20, rate=10)
    belief, history, _ = run(EkfOptions(), d)
    other = without_fixes(make_drive(seconds=20, rate=8), 5, 9)
    with pytest.raises(ShapeError, match="blocks that end elsewhere"):
        smooth(LooselyCoupledEkf(), belief, other.samples, other.fixes, other.timing, history)


def monte_carlo(model_drives, runs):
    """Smooth drives whose errors are drawn from the filter's own model, with 25 s of outage."""
    options, belief, d, sensors = model_drives(runs, 75, 12)
    d, ekf = without_fixes(d, 25, 50), LooselyCoupledEkf(options)
    with torch.no_grad():
        history = ekf(belief, d.samples, d.fixes, d.timing, method="fast")
        found = smooth(ekf, belief, d.samples, d.fixes, d.timing, history)
    truth = NavState(*(torch.gather(x.expand(runs, -1), 1, history.end) for x in d.truth[:4]))

    def error(at):
        position = position_difference(at.state, truth)
        azimuth = (at.state.azimuth - truth.azimuth).unsqueeze(-1)
        return torch.cat((position, azimuth, at.sensor - sensors), -1)

    return (
        {
            name: nees(error(at), at.covariance)
            for name, at in (("filter", history.belief), ("smoother", found.belief))
        },
        {
            name: horizontal(path, d.truth)[:, 250:500].amax(1)
            for name, path in (("filter", history.trajectory), ("smoother", found.trajectory))
        },
    )


def assert_consistent(model_drives, runs, least):
    squares, errors = monte_carlo(model_drives, runs)
    band = mean_band(7, runs)
    for name, values in squares.items():
        epochs = values.mean(0)
        inside = float(((epochs > band.low) & (epochs < band.high)).double().mean())
        mean = float(epochs.mean())
        limits = f"95 % band {band.low:.3f} to {band.high:.3f}"
        sys.stdout.write(f"{name:8} NEES {mean:.3f}, {limits}, {inside:.0%} of epochs inside\n")
        assert band.low < mean < band.high, name
        assert inside > least, name
    gain = 1.0 - float(errors["smoother"].mean() / errors["filter"].mean())
    sys.stdout.write(f"largest error in the outage {gain:.0%} smaller\n")
    assert 0.57 < gain < 0.95


def test_the_smoother_is_as_good_as_it_says(model_drives):
    assert_consistent(model_drives, 25, 0.6)


@pytest.mark.slow
def test_the_smoother_is_as_good_as_it_says_over_two_hundred_runs(model_drives):
    assert_consistent(model_drives, 200, 0.8)
