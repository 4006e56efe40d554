"""Emulated outages of a full-IMU filter: what they are, and what they never see."""

import math
from typing import NamedTuple

import pytest
import torch

from navlearn.errors import FitError
from navlearn.filters.ins_belief import map_ins_belief
from navlearn.frames import enu_between
from navlearn.fusion.ins.history import InsHistory
from navlearn.fusion.ins.loosely_coupled import InsEkf
from navlearn.fusion.ins.options import InsEkfOptions
from navlearn.fusion.ins.start import initial_ins_belief
from navlearn.learning.ins_position_windows import (
    coast_azimuth,
    emulate_ins_outages,
    filter_without_fixes,
    ins_error_increments,
    ins_training_windows,
    select_ins_outages,
    without_increments,
)
from navlearn.learning.pseudo_outages import PseudoOutageOptions
from navlearn.logs.imu_timeline import imu_timeline
from navlearn.logs.synthetic import simulate_drive
from navlearn.mechanization.ins_alignment import InsAlignmentOptions, align_ins
from navlearn.states import FixTiming, GnssFix, ImuSample, InsState

OPTIONS = PseudoOutageOptions(horizon=20.0, every=10.0, settle=10.0, minimum_distance=30.0)
NAMES = ("forward_speed", "yaw_rate", "delay")


class Drive(NamedTuple):
    """A filtered drive."""

    ekf: InsEkf
    samples: ImuSample
    history: InsHistory


@pytest.fixture(scope="module")
def drive():
    log = simulate_drive(
        profile="mixed", grade="mems_m", duration=130.0, seed=11, imu_rate_hz=10.0
    ).log
    line = imu_timeline(log)
    aligned = align_ins(line.samples, line.fixes, line.timing, InsAlignmentOptions())
    first = aligned.sample + 1
    later = line.timing.index >= first
    samples = ImuSample(*(channel[first:] for channel in line.samples))
    ekf = InsEkf(InsEkfOptions())
    start = initial_ins_belief(ekf.options, aligned.state, sensor={"gyro_bias": aligned.gyro_bias})
    with torch.no_grad():
        history = ekf(
            start,
            samples,
            GnssFix(*(channel[later] for channel in line.fixes)),
            FixTiming(line.timing.index[later] - first, line.timing.delay[later]),
            method="sequential",
        )
    return Drive(ekf, samples, history)


def emulated(drive, **changes):
    values = {"method": "sequential", "begin": 100.0, **changes}
    return emulate_ins_outages(drive.ekf, drive.samples, drive.history, OPTIONS, **values)


def test_they_start_from_past_beliefs_and_run_without_fixes(drive):
    found = emulated(drive)
    length = 200
    assert found.block == 10
    assert found.predicted.lat.shape[1] == length
    assert float(found.start_time.diff().min()) >= 10.0 - 1e-6
    k = 1
    sample = round((float(found.start_time[k]) - 100.0) * 10.0)  # first without a fix
    block = int((drive.history.end == sample - 1).nonzero())
    belief = map_ins_belief(drive.history.belief, lambda channel: channel[block : block + 1])
    window = ImuSample(*(c[None, sample : sample + length] for c in drive.samples))
    alone = filter_without_fixes(drive.ekf, belief, window, "sequential")
    assert torch.allclose(alone.lat[0], found.predicted.lat[k], atol=1e-15)
    assert torch.equal(
        found.reference.lat[k], drive.history.trajectory.lat[sample : sample + length]
    )
    # Fixes mattered: coast and later knowledge differ, by metres and not by kilometres.
    error = ins_error_increments(found.predicted, found.reference, found.block).cumsum(1)
    assert 0.05 < float(error[:, -1].norm(dim=-1).mean()) < 30.0


def test_nothing_from_the_end_on_is_looked_at(drive):
    end = 700
    plain = emulated(drive, end=end)
    poisoned = ImuSample(*(channel.clone() for channel in drive.samples))
    for channel in poisoned:
        channel[end:] = math.nan
    path = InsState(*(channel.clone() for channel in drive.history.trajectory))
    for channel in path:
        channel[end:] = math.nan
    other = Drive(drive.ekf, poisoned, drive.history._replace(trajectory=path))
    one, two = (
        ins_training_windows(drive.ekf, found, NAMES) for found in (plain, emulated(other, end=end))
    )
    assert torch.equal(one.u, two.u)
    assert torch.equal(one.y, two.y)
    assert float(plain.start_time.max()) + OPTIONS.horizon <= 100.0 + end / 10.0


def test_a_path_less_its_own_increments_is_the_reference(drive):
    found = emulated(drive)
    increments = ins_error_increments(found.predicted, found.reference, found.block)
    better = without_increments(found.predicted, increments, found.block)
    at = slice(found.block - 1, None, found.block)
    east, north, up = enu_between(
        better.lat[:, at], better.lon[:, at], better.height[:, at],
        *(channel[:, at] for channel in found.reference[:3]),
    )  # fmt: skip
    assert float(torch.hypot(east, north).max()) < 1e-4
    assert torch.equal(better.height, found.predicted.height)
    assert float(up.abs().max()) > 1e-3
    # An unfinished last step is corrected for its share.
    cut = InsState(*(channel[:, :195] for channel in found.predicted))
    part = without_increments(cut, increments, found.block)
    assert torch.equal(part.lat[:, :190], better.lat[:, :190])


def test_along_is_along_the_azimuth_of_the_coast(drive):
    found = emulated(drive)
    azimuth = coast_azimuth(found.predicted)
    ahead = torch.full_like(azimuth, 1e-6)
    moved = found.predicted._replace(
        lat=found.predicted.lat + ahead * torch.cos(azimuth),
        lon=found.predicted.lon + ahead * torch.sin(azimuth) / torch.cos(found.predicted.lat),
    )
    first = ins_error_increments(moved, found.predicted, found.block)[:, 0]
    assert torch.allclose(first[:, 0], torch.full_like(first[:, 0], 6.37), atol=0.03)
    assert float(first[:, 1].abs().max()) < 0.03


def test_windows_and_selection(drive):
    found = emulated(drive)
    windows = ins_training_windows(drive.ekf, found, NAMES)
    assert windows.u.shape == (len(found.start_time), 20, 3)
    assert torch.allclose(windows.u[:, -1, 2], torch.full_like(windows.u[:, -1, 2], 20.0 / 60.0))
    fast = windows.u[..., 0] > 5.0
    speed = found.predicted.v_l[:, 9::10, :2].norm(dim=-1)
    assert float((windows.u[..., 0] - speed).abs()[fast].max()) < 0.5
    last = select_ins_outages(found, torch.tensor([len(found.start_time) - 1]))
    assert torch.equal(ins_training_windows(drive.ekf, last, NAMES).u, windows.u[-1:])


def test_too_short_a_past_is_refused(drive):
    with pytest.raises(FitError, match="start the outages later"):
        emulated(drive, end=150)
    far = PseudoOutageOptions(horizon=20.0, settle=10.0, minimum_distance=1e5)
    with pytest.raises(FitError, match="none of"):
        emulate_ins_outages(drive.ekf, drive.samples, drive.history, far, method="sequential")
