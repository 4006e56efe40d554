"""Thresholds in metres in front of the RISS filter: reasons, reset, and all its forms alike."""

from dataclasses import replace

import pytest
import torch

from navlearn.frames import enu_between, shift_geodetic
from navlearn.fusion.continued import continued
from navlearn.fusion.error_state import initial_belief
from navlearn.fusion.gate_options import GateOptions
from navlearn.fusion.loosely_coupled import LooselyCoupledEkf
from navlearn.fusion.measurements import Kind, Verdict, refused
from navlearn.fusion.motion_watch import MotionWatch
from navlearn.fusion.options import EkfOptions
from navlearn.fusion.sensor_errors import odometer_acceleration
from navlearn.fusion.smoothing import SmoothingOptions, smooth
from navlearn.states import FixTiming, GnssFix, RissSample

pytestmark = pytest.mark.filterwarnings("ignore:filter. :UserWarning")
BY_PREDICTION, BY_MOTION = int(Verdict.REFUSED_BY_PREDICTION), int(Verdict.REFUSED_BY_MOTION)
BY_GATE, RESET = int(Verdict.REFUSED_BY_GATE), int(Verdict.ACCEPTED_BY_RESET)
OFF = GateOptions(probability=1.0)


def run(options, d, method="exact"):
    with torch.no_grad():
        belief = initial_belief(options, d.start)
        return LooselyCoupledEkf(options)(belief, d.samples, d.fixes, d.timing, method=method)


def moved(d, k, east=0.0, north=0.0):
    """Return the drive with some fixes moved; k is a number or a slice."""
    e, n = torch.zeros_like(d.fixes.lat), torch.zeros_like(d.fixes.lat)
    e[:, k], n[:, k] = east, north
    place = shift_geodetic(*d.fixes[:3], e, n, 0.0 * e)
    lat, lon, height = place
    return d._replace(fixes=d.fixes._replace(lat=lat, lon=lon, height=height))


def of_fixes(history, b=0):
    """Return the verdict on every fix's position."""
    position = history.verdict[b, :, Kind.POSITION]
    return position[history.fix[b] >= 0].tolist()


def apart(a, b):
    return max(float(x.abs().max()) for x in enu_between(*a[:3], *b[:3]))


def no_velocity(d):
    none = torch.zeros_like(d.fixes.lat)
    return d._replace(fixes=d.fixes._replace(has_velocity=none))


def test_the_verdict_names_the_first_of_the_tests_that_refuse(make_drive):
    spoiled = moved(make_drive(seconds=60), 40, east=60.0)
    everything = GateOptions(prediction_limit=20.0, motion_limit=20.0)
    for gate, reason in (
        (everything, BY_PREDICTION),
        (replace(everything, prediction_limit=1e3), BY_MOTION),
        (replace(everything, prediction_limit=1e3, motion_limit=1e3), BY_GATE),
        (replace(everything, probability=1.0, motion_limit=1e3), BY_PREDICTION),
        (replace(everything, probability=1.0, prediction_limit=1e3), BY_MOTION),
    ):
        said = of_fixes(run(EkfOptions(gate=gate), spoiled))
        assert said[40] == reason
        assert sum(v != int(Verdict.ACCEPTED) for v in said) == 1


def test_the_distance_from_the_prediction_is_that_of_the_innovation(make_drive):
    d = make_drive(seconds=60, position_sigma=3.0)
    options = EkfOptions(gate=replace(OFF, prediction_limit=6.0), lever_arm=(0.4, -1.0, 1.5))
    history = run(options, d)
    here = history.fix[0] >= 0
    distance = torch.hypot(*history.innovation[0][here][:, :2].unbind(-1))
    far = (distance > 6.0).tolist()
    assert 2 < sum(far) < 30
    assert [v == BY_PREDICTION for v in of_fixes(history)] == far


def test_a_refused_fix_is_as_good_as_none(make_drive):
    d = make_drive(seconds=60)
    has = torch.ones_like(d.fixes.lat)
    has[0, 40] = 0.0
    gate = GateOptions(probability=1.0, prediction_limit=25.0, motion_limit=25.0)
    spoiled = run(EkfOptions(gate=gate), moved(d, 40, east=60.0))
    without = run(EkfOptions(gate=gate), d._replace(fixes=d.fixes._replace(has_position=has)))
    assert apart(spoiled.trajectory, without.trajectory) < 1e-9


def test_as_printed_a_fast_drive_and_the_first_good_fix_are_refused_but_not_by_the_odometer(
    make_drive,
):
    d = moved(make_drive(seconds=60), 40, east=60.0)
    printed = replace(OFF, motion_limit=8.0, motion_reference="none", reset_after=1000)
    said = of_fixes(run(EkfOptions(gate=printed), d))
    step = enu_between(*(x[0, 1:] for x in d.fixes[:3]), *(x[0, :-1] for x in d.fixes[:3]))
    far = [False, *(torch.hypot(step[0], step[1]) > 8.0).tolist()]
    assert [v == BY_MOTION for v in said] == far
    assert said[40] == said[41] == BY_MOTION
    assert sum(far) > 30
    ours = of_fixes(run(EkfOptions(gate=replace(printed, motion_reference="odometer")), d))
    assert [k for k, v in enumerate(ours) if v == BY_MOTION] == [40]


@pytest.mark.parametrize("method", ["exact", "fast", "sequential"])
@pytest.mark.parametrize("limit", ["prediction_limit", "motion_limit"])
def test_the_reset_frees_a_filter_that_a_threshold_locks_out(make_drive, limit, method):
    d = moved(no_velocity(make_drive(seconds=70, rate=10)), slice(40, None), north=200.0)
    gate = GateOptions(**{limit: 15.0}, probability=1.0, reset_after=5)
    history = run(EkfOptions(gate=gate), d, method)
    said = of_fixes(history)
    reason = BY_PREDICTION if limit == "prediction_limit" else BY_MOTION
    # the motion test believes a jump that stays, as the filter does; the gate is off beside it
    after = RESET if limit == "prediction_limit" else int(Verdict.ACCEPTED)
    assert said[40:47] == [reason] * 5 + [after, int(Verdict.ACCEPTED)]
    end = [x[:, -1] for x in history.belief.state]
    assert apart(end, [x[:, -1] for x in d.fixes[:3]]) < 8.0
    assert history.method == method


def test_refusals_for_any_reason_count_together_and_free_the_filter(make_drive):
    d = moved(no_velocity(make_drive(seconds=70, rate=10)), slice(40, None), north=200.0)
    gate = GateOptions(motion_limit=15.0, reset_after=5)
    said = of_fixes(run(EkfOptions(gate=gate), d))
    assert said[40:47] == [BY_MOTION] * 5 + [RESET, int(Verdict.ACCEPTED)]


def test_a_slow_ramp_leads_the_filter_astray_and_its_end_is_refused(make_drive):
    d = no_velocity(make_drive(seconds=90, rate=10))
    ramp = (torch.arange(90, dtype=torch.float64) - 40).clamp(0, 30) * 0.7
    ramp[71:] = 0.0
    d = moved(d, slice(None), east=ramp)
    gate = GateOptions(motion_limit=10.0, prediction_limit=15.0, reset_after=6, probability=1.0)
    history = run(EkfOptions(gate=gate), d)
    said = of_fixes(history)
    assert not any(refused(torch.tensor(said[:71])).tolist())
    assert said[71:77] == [BY_PREDICTION] * 6
    assert said[77] == RESET
    ends = [x[0][history.fix[0] >= 0][70] for x in history.belief.state[:3]]
    truth = [x[0, 10 * 71 - 1] for x in d.truth[:3]]
    assert apart(ends, truth) > 8.0


CHOICES = {
    "prediction": GateOptions(prediction_limit=5.0, probability=1.0),
    "motion": GateOptions(motion_limit=4.0, reset_after=3),
    "printed": GateOptions(motion_limit=15.0, motion_reference="none", reset_after=4),
    "all": GateOptions(prediction_limit=30.0, motion_limit=6.0, reset_after=4),
}


def spoiled_drives(make_drive):
    d = make_drive(seconds=60, rate=10, batch=3, position_sigma=1.5)
    d = moved(d, 20, east=40.0)
    d = moved(d, slice(30, 38), north=25.0)
    has = d.fixes.has_position.clone()
    has[1, 41:52] = 0.0
    index = d.timing.index.clone()
    index[2, 50:] = -1
    timing = FixTiming(index, d.timing.delay + 0.03)
    return d._replace(fixes=d.fixes._replace(has_position=has), timing=timing)


@pytest.mark.parametrize("name", CHOICES)
def test_all_forms_refuse_the_same_fixes_for_the_same_reasons(make_drive, name):
    d = spoiled_drives(make_drive)
    options = EkfOptions(gate=CHOICES[name], lever_arm=(0.4, -1.0, 1.5))
    exact, fast, turn = (run(options, d, m) for m in ("exact", "fast", "sequential"))
    assert fast.method == "fast"
    assert int(refused(exact.verdict[..., Kind.POSITION]).sum()) > 6
    for other in (fast, turn):
        assert torch.equal(other.verdict, exact.verdict)
        assert torch.equal(other.belief.refused, exact.belief.refused)
        assert apart(other.trajectory, exact.trajectory) < 1e-3
    for b in range(3):
        alone = type(d)(*(type(v)(*(x[b : b + 1] for x in v)) for v in d))
        single = run(options, alone)
        count = int((single.fix >= 0).sum())
        assert of_fixes(single)[:count] == of_fixes(exact, b)[:count]


def test_an_open_loop_refuses_by_its_estimate(make_drive):
    d = moved(make_drive(seconds=60, rate=10), 40, east=60.0)
    gate = GateOptions(prediction_limit=15.0, motion_limit=15.0)
    closed, free = (of_fixes(run(EkfOptions(gate=gate, feedback=f), d)) for f in ("closed", "open"))
    assert closed == free
    assert closed[40] == BY_PREDICTION


@pytest.mark.parametrize("name", ["motion", "printed", "all"])
def test_streaming_with_a_watch_beside_it_equals_the_record(make_drive, name):
    d = spoiled_drives(make_drive)
    d = type(d)(*(type(v)(*(x[:1] for x in v)) for v in d))
    d = d._replace(
        samples=RissSample(*(x[:, :420] for x in d.samples)),
        fixes=GnssFix(*(x[:, :42] for x in d.fixes)),
        timing=FixTiming(*(x[:, :42] for x in d.timing)),
    )
    options = EkfOptions(
        gate=CHOICES[name], zero_yaw_rate=False, lever_arm=(0.4, -1.0, 1.5), max_block=1.0
    )
    history = run(options, d, "sequential")
    filter_, watch = LooselyCoupledEkf(options), MotionWatch(options)
    belief, track = initial_belief(options, d.start), watch.start(d.start.lat)
    push = odometer_acceleration(d.samples.dt, d.samples.speed)
    with torch.no_grad():
        for k in range(d.samples.dt.shape[1]):
            sample = RissSample(*(x[:, k] for x in d.samples))
            belief, track = filter_.step(belief, sample), watch.step(track, sample)
            if (k + 1) % 10 == 0:
                fix = GnssFix(*(x[:, k // 10] for x in d.fixes))
                late = d.timing.delay[:, k // 10]
                track, wild = watch.judge(track, fix, sample, late)
                belief = filter_.update(
                    belief, fix, sample, delay=late, acceleration=push[:, k], astray=wild
                )
    assert int((history.verdict == BY_MOTION).sum()) > 1
    assert apart(belief.state, [x[:, -1] for x in history.belief.state]) < 1e-6
    torch.testing.assert_close(belief.refused, history.belief.refused[:, -1])


def test_a_run_goes_on_from_the_middle_as_if_it_had_never_stopped(make_drive):
    d = spoiled_drives(make_drive)
    d = type(d)(*(type(v)(*(x[0] for x in v)) for v in d))
    options = EkfOptions(gate=CHOICES["all"])
    ekf = LooselyCoupledEkf(options)
    whole = run(options, d, "fast")
    some = 33
    gone = int(d.timing.index[some]) + 1
    begun = d._replace(
        samples=RissSample(*(x[:gone] for x in d.samples)),
        fixes=GnssFix(*(x[: some + 1] for x in d.fixes)),
        timing=FixTiming(*(x[: some + 1] for x in d.timing)),
    )
    earlier = run(options, begun, "fast")
    block = int((earlier.fix == some).nonzero()[0])
    later = continued(ekf, earlier, block, d.samples, d.fixes, d.timing)
    assert torch.equal(later.verdict, whole.verdict)
    assert int((whole.verdict == BY_MOTION).sum()) > 0
    assert apart(later.trajectory, whole.trajectory) < 1e-3


def test_smoothing_keeps_to_what_was_refused(make_drive):
    d = make_drive(seconds=60, rate=10)
    gate = GateOptions(probability=1.0, prediction_limit=25.0, motion_limit=25.0)
    has = torch.ones_like(d.fixes.lat)
    has[0, 40] = 0.0
    found = []
    for one in (moved(d, 40, east=60.0), d._replace(fixes=d.fixes._replace(has_position=has))):
        options = EkfOptions(gate=gate)
        ekf, belief = LooselyCoupledEkf(options), initial_belief(options, one.start)
        with torch.no_grad():
            history = ekf(belief, one.samples, one.fixes, one.timing)
            given = (ekf, belief, one.samples, one.fixes, one.timing, history)
            found.append(smooth(*given, SmoothingOptions(passes=1)))
    assert apart(found[0].trajectory, found[1].trajectory) < 1e-6


def test_a_limit_that_refuses_most_fixes_is_named_in_the_warning(make_drive):
    printed = replace(OFF, motion_limit=3.0, motion_reference="none", reset_after=1000)
    d = make_drive(seconds=60, rate=10)
    with pytest.warns(UserWarning, match="position; the noise or a limit in metres is too small"):
        run(EkfOptions(gate=printed), d)


@pytest.mark.parametrize(
    "gate", [GateOptions(reset_after=3), GateOptions(prediction_limit=5.0, reset_after=3)]
)
def test_a_receiver_that_tells_no_numbers_never_resets_the_filter(make_drive, gate):
    d = make_drive(seconds=10, rate=10)
    d = type(d)(*(type(v)(*(x[0] for x in v)) for v in d))
    options = EkfOptions(gate=gate)
    filter_, belief = LooselyCoupledEkf(options), initial_belief(options, d.start)
    with torch.no_grad():
        for k in range(100):
            sample = RissSample(*(x[k] for x in d.samples))
            belief = filter_.step(belief, sample)
            if (k + 1) % 10 == 0:
                fix = GnssFix(*(x[k // 10] for x in d.fixes))
                if 1 <= k // 10 < 9:
                    fix = fix._replace(lat=fix.lat * torch.nan)
                belief = filter_.update(belief, fix, sample)
    assert bool(torch.isfinite(belief.covariance).all())
    assert apart(belief.state, [x[-1] for x in d.truth[:3]]) < 5.0
    assert float(belief.refused[Kind.POSITION]) == 0.0
