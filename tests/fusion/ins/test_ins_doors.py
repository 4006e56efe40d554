"""What the full-IMU filter refuses, each error once, and its options."""

import math

import pytest
import torch

from navlearn.errors import ConfigError, FilterDivergedError, LogError, ShapeError
from navlearn.fusion.ins.layout import INS_ERROR_UNITS, ins_layout
from navlearn.fusion.ins.loosely_coupled import InsEkf
from navlearn.fusion.ins.options import InsEkfOptions, InsInitialOptions, InsNoiseOptions
from navlearn.fusion.ins.start import initial_ins_belief
from navlearn.states import FixTiming, GnssFix, ImuSample, InsState

G = 9.80665


def run(d, options=None, belief=None):
    ekf = InsEkf(options)
    with torch.no_grad():
        start = initial_ins_belief(ekf.options, d.start) if belief is None else belief
        return ekf(start, d.samples, d.fixes, d.timing)


@pytest.fixture
def drive(make_clean):
    return make_clean(8.0, 25)


def with_samples(d, **channels):
    return d._replace(samples=d.samples._replace(**channels))


def test_values_that_are_not_finite_are_refused(drive):
    force = drive.samples.f_b.clone()
    force[7, 2] = math.nan
    with pytest.raises(LogError, match=r"samples.f_b of drive 0 is nan at sample 7"):
        run(with_samples(drive, f_b=force))
    height = drive.fixes.height.clone()
    height[3] = math.inf
    with pytest.raises(LogError, match=r"fixes.height of drive 0 is inf at fix 3"):
        run(drive._replace(fixes=drive.fixes._replace(height=height)))


def test_degrees_are_refused(drive):
    turning = drive.samples.omega_ib_b + torch.tensor([0.0, 0.0, 0.3]).double()
    with pytest.raises(LogError, match=r"math\.radians"):
        run(with_samples(drive, omega_ib_b=torch.rad2deg(turning)))


@pytest.mark.parametrize("change", ["in g", "removed", "swapped"])
def test_forces_that_are_no_specific_force_are_refused(drive, change):
    force = {
        "in g": drive.samples.f_b / G,
        "removed": drive.samples.f_b - torch.tensor([0.0, 0.0, G]).double(),
        "swapped": 4.0 * drive.samples.f_b,
    }[change]
    with pytest.raises(LogError, match="specific force"):
        run(with_samples(drive, f_b=force))


def test_padding_is_not_asked_for_gravity(drive):
    """A drive shorter than its batch is padded by samples of no length and any force."""
    one = torch.stack
    zero = torch.zeros_like(drive.samples.dt)
    short = drive.samples._replace(
        dt=torch.where(torch.arange(len(zero)) < 100, drive.samples.dt, zero),
        f_b=torch.where((torch.arange(len(zero)) < 100)[:, None], drive.samples.f_b, 0.0),
    )
    keep = drive.timing.index < 100
    index = torch.where(keep, drive.timing.index, torch.tensor(-1))
    samples = ImuSample(*(one(p) for p in zip(drive.samples, short, strict=True)))
    fixes = GnssFix(*(one((x, x)) for x in drive.fixes))
    timing = FixTiming(one((drive.timing.index, index)), one((drive.timing.delay,) * 2))
    options = InsEkfOptions()
    start = initial_ins_belief(options, InsState(*(one((x, x)) for x in drive.start)))
    with torch.no_grad():
        history = InsEkf(options)(start, samples, fixes, timing)
    assert bool(torch.isfinite(history.trajectory.v_l).all())
    torch.testing.assert_close(
        history.trajectory.lat[1, 99:], history.trajectory.lat[1, 99].expand(101)
    )


def test_wrong_shapes_and_types_are_refused(drive):
    with pytest.raises(
        ShapeError, match=r"samples.f_b has shape \(1, 200\); expected \(1, 200, 3\)"
    ):
        run(with_samples(drive, f_b=drive.samples.f_b[:, 0]))
    with pytest.raises(ShapeError, match=r"samples.speed is torch.float32; expected float64"):
        run(with_samples(drive, speed=drive.samples.speed.float()))
    other = initial_ins_belief(InsEkfOptions(states=21), drive.start)
    with pytest.raises(ShapeError, match=r"start.covariance has shape \(1, 22, 22\)"):
        run(drive, belief=other)
    empty = drive._replace(samples=ImuSample(*(x[:0] for x in drive.samples)))
    with pytest.raises(ShapeError, match="at least one sample"):
        run(empty)


def at(channel, place, value):
    changed = channel.clone()
    changed[place] = value
    return changed


OUT_OF_BOUNDS = [
    ("samples.dt", 7, -0.04, r"samples\.dt of drive 0 is -0.04 s at sample 7.*sort the samples"),
    ("samples.dt", 7, 5.0, r"samples\.dt of drive 0 is 5 s at sample 7.*cut the drive at the gap"),
    ("timing.delay", 3, -0.5, r"timing\.delay of drive 0 is -0.5 s at fix 3; expected -0.04 "),
    ("timing.delay", 3, 30.0, r"timing\.delay of drive 0 is 30 s at fix 3.*end minus its time"),
    ("fixes.std_e", 2, -1.0, r"fixes\.std_e of drive 0 is -1 at fix 2.*has_position to 0"),
    ("fixes.std_u", 2, 0.0, r"fixes\.std_u of drive 0 is 0 at fix 2; expected .* above 0"),
    ("fixes.std_v", 2, 0.0, r"fixes\.std_v of drive 0 is 0 at fix 2.*has_velocity to 0"),
    ("fixes.lat", 4, 44.2, r"fixes\.lat of drive 0 is 44.2 at fix 4.*math\.radians"),
    ("fixes.lon", 4, -76.5, r"fixes\.lon of drive 0 is -76.5 at fix 4.*math\.radians"),
    ("start.lat", (), 44.2, r"start\.state\.lat of drive 0 is 44.2; expected .*math\.radians"),
]


@pytest.mark.parametrize(("channel", "place", "value", "message"), OUT_OF_BOUNDS)
def test_what_no_drive_can_hold_is_refused(drive, channel, place, value, message):
    part, name = channel.split(".")
    whole = getattr(drive, part)
    wrong = whole._replace(**{name: at(getattr(whole, name), place, value)})
    with pytest.raises(LogError, match=message):
        run(drive._replace(**{part: wrong}))


def test_what_is_not_valid_may_be_anything_finite(drive):
    """No fix, no position, no velocity: their places and deviations are not looked at."""
    fixes, timing = drive.fixes, drive.timing
    fixes = fixes._replace(
        has_position=at(fixes.has_position, 2, 0.0),
        std_e=at(at(fixes.std_e, 2, 0.0), 0, -1.0),
        lat=at(at(fixes.lat, 2, 50.0), 0, 99.0),
        has_velocity=at(fixes.has_velocity, 3, 0.0),
        std_v=at(fixes.std_v, 3, 0.0),
    )
    timing = timing._replace(index=at(timing.index, 0, -1), delay=at(timing.delay, 0, -9.0))
    # a fix is used at the nearest end of a sample, which may come half a sample early
    timing = timing._replace(delay=at(timing.delay, 4, -0.02))
    history = run(drive._replace(fixes=fixes, timing=timing))
    assert bool(torch.isfinite(history.trajectory.lat).all())


def test_fixes_out_of_order_are_refused(drive):
    index = drive.timing.index.flip(0)
    with pytest.raises(LogError, match="sort the fixes by time"):
        run(drive._replace(timing=drive.timing._replace(index=index)))


def test_a_start_without_variance_is_refused(drive):
    belief = initial_ins_belief(InsEkfOptions(), drive.start, sigmas={"azimuth": 0.0})
    with pytest.raises(FilterDivergedError, match="standard deviation"):
        run(drive, belief=belief)


def test_a_lost_covariance_is_told(drive):
    belief = initial_ins_belief(InsEkfOptions(), drive.start)
    wild = belief.covariance.clone()
    wild[3, 6] = wild[6, 3] = 50.0  # correlated beyond one
    with pytest.raises(FilterDivergedError, match="lost its estimate"):
        run(drive, belief=belief._replace(covariance=wild))


def test_noise_far_too_small_is_warned_about(make_drive, lever_arm):
    d = make_drive(seconds=40, rate=25)
    bold = InsNoiseOptions(position_floor=0.0, height_floor=0.0, position_inflation=0.05)
    options = InsEkfOptions(lever_arm=lever_arm, noise=bold)
    with (
        pytest.warns(UserWarning, match="raise position_inflation.* in InsNoiseOptions"),
        pytest.warns(UserWarning, match="refused more than 50%"),
    ):
        run(d, options)


@pytest.mark.parametrize(
    ("choice", "message"),
    [
        ({"states": 18}, "InsEkfOptions.states: found 18; choose among 9, 15, 21"),
        ({"model": "psi_angle"}, "InsEkfOptions.model"),
        ({"feedback": "half"}, "InsEkfOptions.feedback"),
        ({"max_block": 0.0}, "expected more than 0 s"),
        ({"max_block": 5.0}, "at most 1 s"),
        ({"aiding_interval": -1.0}, "InsEkfOptions.aiding_interval"),
        ({"correlation_time": 0.0}, "InsEkfOptions.correlation_time"),
        ({"lever_arm": (1.0, 2.0)}, "three finite numbers"),
        ({"mounting": (0.0, 90.0, 0.0)}, "math.radians"),
        ({"noise": InsNoiseOptions(turn_noise=-1.0)}, "InsNoiseOptions.turn_noise"),
        ({"initial": InsInitialOptions(tilt=0.0)}, "InsInitialOptions.tilt"),
    ],
)
def test_options_out_of_range_are_refused(choice, message):
    with pytest.raises(ConfigError, match=message):
        InsEkfOptions(**choice)


def test_belief_takes_names_of_errors_and_of_groups(drive):
    options = InsEkfOptions(odometer_scale=False)
    belief = initial_ins_belief(
        options,
        drive.start,
        sensor={"gyro_bias": torch.tensor([1.0, 2.0, 3.0]), "accel_bias_z": 0.5, "gyro_scale": 9.0},
        sigmas={"tilt": 0.1, "azimuth": 0.2, "gyro_bias": torch.tensor([4.0, 5.0, 6.0])},
    )
    assert belief.sensor.tolist() == [1.0, 2.0, 3.0, 0.0, 0.0, 0.5]
    sigma = belief.covariance.diagonal().sqrt()
    expected = torch.tensor([0.1, 0.1, 0.2, 4.0, 5.0, 6.0]).double()
    torch.testing.assert_close(sigma[6:12], expected)
    with pytest.raises(ConfigError, match="sigmas names 'heading'"):
        initial_ins_belief(options, drive.start, sigmas={"heading": 1.0})


def test_names_have_units_and_an_order():
    names = ins_layout(InsEkfOptions(states=21)).names
    assert names[:9] == (
        "east", "north", "up", "v_east", "v_north", "v_up", "phi_east", "phi_north", "phi_up",
    )  # fmt: skip
    assert names[9::3] == (
        "gyro_bias_x",
        "accel_bias_x",
        "gyro_scale_x",
        "accel_scale_x",
        "odometer_scale",
    )
    assert set(names) == set(INS_ERROR_UNITS)
    assert ins_layout(InsEkfOptions(states=21)).of("accel_bias") == [12, 13, 14]
    assert "odometer_scale" not in ins_layout(InsEkfOptions(odometer=False)).names
