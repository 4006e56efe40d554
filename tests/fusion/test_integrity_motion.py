"""Has a fix moved as the car did? Hand-made drives on which the answer is known."""

import math

import pytest
import torch

from navlearn.frames import shift_geodetic
from navlearn.fusion.gate_options import GateOptions
from navlearn.fusion.motion_check import astray
from navlearn.fusion.motion_watch import MotionWatch
from navlearn.fusion.options import EkfOptions
from navlearn.fusion.seen_fixes import Carriage
from navlearn.mechanization.options import RissOptions
from navlearn.states import FixTiming, GnssFix, RissSample

RATE = 10
LIMIT = GateOptions(motion_limit=5.0)
PRINTED = GateOptions(motion_limit=5.0, motion_reference="none")


def car(speed, turn_rate=0.0, seconds=20, every=1.0, arm=(0.0, 0.0)):
    """Carriage of a car that starts northwards, and exact fixes of its antenna, in metres."""
    count = seconds * RATE
    one = torch.ones(1, count, dtype=torch.float64)
    motion = Carriage(one / RATE, turn_rate * one, speed * one, one)
    heading = torch.cat((0.0 * one[:, :1], torch.cumsum(turn_rate * one / RATE, 1)), 1)
    middle = 0.5 * (heading[:, 1:] + heading[:, :-1])
    east = torch.cumsum(speed / RATE * torch.sin(middle), 1)
    north = torch.cumsum(speed / RATE * torch.cos(middle), 1)
    step = round(every * RATE)
    index = torch.arange(step - 1, count, step).unsqueeze(0)
    at = heading[:, 1:][:, index[0]]
    right, forward = arm
    east = east[:, index[0]] + right * torch.cos(at) + forward * torch.sin(at)
    north = north[:, index[0]] - right * torch.sin(at) + forward * torch.cos(at)
    return motion, east, north, FixTiming(index, torch.zeros_like(east))


def fixes_at(east, north, has=None):
    zero = torch.zeros_like(east)
    place = shift_geodetic(0.8 + zero, 0.1 + zero, 300.0 + zero, east, north, zero)
    one = torch.ones_like(zero)
    return GnssFix(*place, zero, zero, zero, one, one, one, one, one if has is None else has, zero)


def refused(gate, motion, east, north, timing, arm=(0.0, 0.0), has=None):
    found = astray(gate, arm, motion, fixes_at(east, north, has), timing)
    return [b.nonzero().flatten().tolist() for b in found > 0.5]


def test_as_printed_every_fast_drive_is_refused_and_by_the_odometer_none():
    drive = car(20.0)
    assert refused(PRINTED, *drive) == [list(range(1, 20))]
    assert refused(LIMIT, *drive) == [[]]


def test_as_printed_the_first_good_fix_after_an_outlier_is_refused_and_by_the_odometer_it_is_not():
    for speed in (0.0, 4.0):
        motion, east, north, timing = car(speed)
        east[0, 7] += 50.0
        assert refused(PRINTED, motion, east, north, timing) == [[7, 8]]
        assert refused(LIMIT, motion, east, north, timing) == [[7]]


def test_two_outliers_side_by_side_are_both_refused_though_they_agree():
    motion, east, north, timing = car(10.0)
    north[0, 7:9] += 30.0
    assert refused(LIMIT, motion, east, north, timing) == [[7, 8]]


def test_a_half_circle_is_as_far_as_its_chord():
    speed, radius = 15.0, 60.0
    half = math.pi * radius / speed
    none = GateOptions(motion_limit=0.5, motion_growth=0.0)
    drive = car(speed, speed / radius, seconds=60, every=round(half))
    assert refused(none, *drive) == [[]]


def test_the_antenna_swings_round_the_odometer():
    arm = (0.5, 4.0)
    tight = GateOptions(motion_limit=0.2, motion_growth=0.0)
    drive = car(2.0, 0.5, seconds=30, every=3.0, arm=arm)
    assert refused(tight, *drive, arm=arm) == [[]]
    assert refused(tight, *drive) != [[]]


def test_a_late_fix_is_compared_where_it_was_valid():
    motion, east, north, timing = car(20.0)
    late = torch.zeros_like(east)
    late[0, 8] = 0.4
    north = north - 20.0 * late
    tight = GateOptions(motion_limit=0.1, motion_growth=0.0)
    assert refused(tight, motion, east, north, FixTiming(timing.index, late)) == [[]]
    assert refused(tight, motion, east, north, timing) == [[8]]
    # older than the first sample: the car came as it goes on
    early = FixTiming(timing.index, torch.full_like(late, 2.5))
    assert refused(tight, motion, east, north - 20.0 * (2.5 - late), early) == [[]]


def test_what_is_allowed_grows_with_the_way_and_not_with_time():
    motion, east, north, timing = car(20.0, seconds=120, every=60.0)
    short = motion._replace(speed=0.96 * motion.speed)
    assert refused(
        GateOptions(motion_limit=5.0, motion_growth=0.0), short, east, north, timing
    ) == [[1]]
    assert refused(LIMIT, short, east, north, timing) == [[]]
    parked, east, north, timing = car(0.0, seconds=600, every=60.0)
    east[0, 5] += 6.0
    assert refused(LIMIT, parked, east, north, timing) == [[5]]


def test_a_fix_thrown_aside_of_a_fast_car_is_refused_once_earlier_fixes_tell_where_it_goes():
    for k, found in ((1, []), (7, [7])):
        motion, east, north, timing = car(20.0)
        east[0, k] += 12.0
        assert refused(LIMIT, motion, east, north, timing) == [found]


def test_a_jump_back_by_twice_the_way_is_refused_though_the_distance_is_right():
    motion, east, north, timing = car(10.0)
    north[0, 12] -= 20.0
    assert refused(LIMIT, motion, east, north, timing) == [[12]]


def test_after_a_wrong_fix_that_was_believed_the_good_ones_are_believed_again():
    motion, east, north, timing = car(5.0, seconds=30)
    # just inside the limit and aside, and the next one outside it as seen from there
    east[0, 12], east[0, 13] = 5.2, -0.5
    assert refused(LIMIT, motion, east, north, timing) == [[]]
    east[0, 12] = 5.7
    assert refused(LIMIT, motion, east, north, timing) == [[12]]


def test_an_unknown_gyro_bias_refuses_no_good_fix():
    drive = car(15.0, 0.2, seconds=60)
    wrong = drive[0]._replace(turn_rate=drive[0].turn_rate + math.radians(0.5))
    assert refused(GateOptions(motion_limit=1.5), wrong, *drive[1:]) == [[]]


def test_a_jump_that_stays_is_believed_after_patience_and_a_ramp_is_never_seen():
    motion, east, north, timing = car(10.0, seconds=40)
    north[0, 20:] += 80.0
    gate = GateOptions(motion_limit=5.0, reset_after=6)
    assert refused(gate, motion, east, north, timing) == [list(range(20, 26))]
    motion, east, north, timing = car(10.0, seconds=40)
    ramp = torch.arange(40, dtype=torch.float64).clamp(10, 30) - 10
    assert refused(gate, motion, east, north + ramp, timing) == [[]]
    # when it ends at once, that is a jump
    ramp[31:] = 0.0
    assert refused(gate, motion, east, north + ramp, timing) == [list(range(31, 37))]


def test_without_an_odometer_between_them_two_fixes_are_not_compared():
    motion, east, north, timing = car(10.0)
    told = motion.told.clone()
    told[0, 75] = 0.0
    north[0, 7:] += 60.0
    blind = motion._replace(told=told, speed=motion.speed * told)
    assert refused(LIMIT, blind, east, north, timing) == [[]]
    assert refused(LIMIT, motion, east, north, timing) == [list(range(7, 17))]


@pytest.mark.parametrize("gate", [LIMIT, PRINTED])
def test_drives_of_a_batch_are_judged_alone_and_what_is_no_fix_is_passed_over(gate):
    drives = [car(s, seconds=20) for s in (0.0, 3.0, 12.0)]
    motion = Carriage(*(torch.cat(c) for c in zip(*(d[0] for d in drives), strict=True)))
    east, north = (torch.cat([d[k] for d in drives]) for k in (1, 2))
    east[:, 9] += 40.0
    index = drives[0][3].index.repeat(3, 1)
    has = torch.ones_like(east)
    has[1, 9], index[2, 15:] = 0.0, -1
    timing = FixTiming(index, torch.zeros_like(east))
    together = refused(gate, motion, east, north, timing, has=has)
    for b in range(3):
        kept = [k for k in range(20) if index[b, k] >= 0 and has[b, k] > 0.5]
        alone = refused(
            gate,
            Carriage(*(c[b : b + 1] for c in motion)),
            east[b : b + 1, kept],
            north[b : b + 1, kept],
            FixTiming(index[b : b + 1, kept], torch.zeros(1, len(kept), dtype=torch.float64)),
        )
        assert together[b] == [kept[k] for k in alone[0]]
    assert together[1] == [] if gate is LIMIT else together[0] == [9, 10]


def test_no_limit_and_no_fix_refuse_nothing():
    motion, east, north, timing = car(20.0)
    assert refused(GateOptions(), motion, east + 1e5 * timing.index, north, timing) == [[]]
    none = FixTiming(timing.index[:, :0], timing.delay[:, :0])
    assert refused(LIMIT, motion, east[:, :0], north[:, :0], none) == [[]]


@pytest.mark.parametrize("reset_after", [2, 10])
def test_asked_while_driving_and_over_the_record_the_answers_are_the_same(reset_after):
    g = torch.Generator().manual_seed(1)

    def normal(*shape):
        return torch.randn(*shape, generator=g, dtype=torch.float64)

    batch, count = 4, 1500
    dt = torch.full((batch, count), 1.0 / RATE, dtype=torch.float64)
    rate = 0.2 * torch.sin(torch.cumsum(0.01 * normal(batch, count), 1))
    speed = (8.0 + 8.0 * torch.sin(torch.cumsum(0.05 * normal(batch, count), 1))).clamp(min=0.0)
    middle = torch.cumsum(rate * dt, 1) - 0.5 * rate * dt
    index = torch.arange(RATE - 1, count, RATE).expand(batch, -1).contiguous()
    east, north = (
        torch.gather(torch.cumsum(speed * dt * turned(middle), 1), 1, index) + normal(*index.shape)
        for turned in (torch.sin, torch.cos)
    )
    hit = torch.rand(index.shape, generator=g) < 0.06
    east = east + hit * 15.0 * normal(*index.shape)
    east[:, 50:70] += 30.0
    north[:, 100:] += 50.0
    fixes, late = fixes_at(east, north), torch.full_like(east, 0.04)
    gate = GateOptions(motion_limit=6.0, reset_after=reset_after)
    options = EkfOptions(gate=gate, mechanization=RissOptions(dimensions=2))
    carriage = Carriage(dt, rate, speed, torch.ones_like(dt))
    # the car was a moment earlier where late fixes are
    record = astray(gate, (0.0, 0.0), carriage, fixes, FixTiming(index, late))
    none = torch.zeros_like(dt)
    samples = RissSample(dt, -rate, speed, none, none, none, none, none)
    watch, told = MotionWatch(options), []
    track = watch.start(east[:, 0])
    for k in range(count):
        sample = RissSample(*(x[:, k] for x in samples))
        track = watch.step(track, sample)
        if (k + 1) % RATE == 0:
            fix = GnssFix(*(x[:, k // RATE] for x in fixes))
            track, wild = watch.judge(track, fix, sample, late[:, k // RATE])
            told.append(wild)
    assert 20 < int(record.sum()) < 300
    assert torch.equal(torch.stack(told, 1), record)


def test_a_fix_without_position_makes_no_other_forgotten():
    motion, east, north, timing = car(20.0, seconds=12)
    has = torch.ones_like(east)
    # the tenth has no position, and a place that would speak against the ninth
    east[0, 8:11], has[0, 9] = torch.tensor([4.8, -1.0, 9.0], dtype=torch.float64), 0.0
    gate = GateOptions(motion_limit=5.0, motion_growth=0.0)
    fixes = fixes_at(east, north, has)
    record = astray(gate, (0.0, 0.0), motion, fixes, timing)
    watch = MotionWatch(EkfOptions(gate=gate, mechanization=RissOptions(dimensions=2)))
    track, told = watch.start(east[:, 0]), []
    zero = torch.zeros(1, dtype=torch.float64)
    sample = RissSample(zero + 1.0 / RATE, zero, zero + 20.0, zero, zero, zero, zero, zero)
    for k in range(motion.dt.shape[1]):
        track = watch.step(track, sample)
        if (k + 1) % RATE == 0:
            track, wild = watch.judge(track, GnssFix(*(x[:, k // RATE] for x in fixes)), sample)
            told.append(float(wild))
    assert told == record[0].tolist()
    assert told[:11] == [0.0] * 11
