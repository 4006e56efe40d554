"""Faulty fixes neither throw the full-IMU filter off for good nor lock it out."""

import math
from dataclasses import replace

import numpy as np
import pytest
import torch

from navlearn import attitude
from navlearn.fusion.gating import judged
from navlearn.fusion.gating_over_time import judged_over_time
from navlearn.fusion.ins.layout import state_difference
from navlearn.fusion.ins.measurements import InsKind
from navlearn.fusion.ins.model import ins_filter_model
from navlearn.fusion.ins.options import InsEkfOptions
from navlearn.fusion.measurements import Verdict
from navlearn.ins_navigator import InsNavigator, InsNavigatorOptions, InsNavigatorRun
from navlearn.logs.imu_timeline import imu_timeline
from navlearn.logs.synthetic import simulate_drive

pytestmark = pytest.mark.filterwarnings("ignore:filter. :UserWarning")
FAULT = (120.0, 165.0)


@pytest.fixture(scope="module")
def drive():
    return simulate_drive(
        profile="town", grade="mems_m", duration=260.0, seed=11, imu_rate_hz=50.0, standstill=15.0
    ).log


def run_with(
    drive, method: str = "fast", fault: tuple[float, float] = FAULT, **wrong: float
) -> tuple[InsNavigatorRun, np.ndarray]:
    """Return the run on fixes that are off through the fault, and its times."""
    fixes = drive.fixes.copy()
    faulty = fixes["t"].between(*fault)
    for name, value in wrong.items():
        since = fixes.loc[faulty, "t"] - fault[0]
        fixes.loc[faulty, name] += value * (since if name == "height" else 1.0)
    line = imu_timeline(replace(drive, fixes=fixes))
    options = InsNavigatorOptions(method=method)
    run = InsNavigator(options).run(line.samples, line.fixes, line.timing)
    return run, line.t[run.first :].numpy()


def errors_at(
    run: InsNavigatorRun, t: np.ndarray, drive, time: float
) -> tuple[float, float, float]:
    """Return horizontal error (m), azimuth and tilt error (rad) at a time."""
    k, truth = int(np.searchsorted(t, time)), drive.reference
    path = run.history.trajectory

    def true(name: str) -> float:
        return float(np.interp(t[k], truth["t"], np.unwrap(truth[name])))

    north = (float(path.lat[k]) - true("lat")) * 6.37e6
    east = (float(path.lon[k]) - true("lon")) * 6.37e6 * math.cos(true("lat"))
    angles = attitude.angles_from_matrix(attitude.matrix_from_quaternion(path.q_lb[k]))
    azimuth, pitch, roll = (float(angle) for angle in angles)
    off = math.remainder(azimuth - true("azimuth"), 2.0 * math.pi)
    return math.hypot(north, east), off, math.hypot(pitch - true("pitch"), roll - true("roll"))


def test_after_fixes_that_ran_away_the_filter_finds_back(drive) -> None:
    run, t = run_with(drive, v_e=3.0, v_n=-4.0, v_u=5.0, height=2.0, lat=3e-5, lon=-4e-5)
    resets = run.history.resets
    assert resets[InsKind.POSITION] >= 1
    metres, azimuth, tilt = errors_at(run, t, drive, FAULT[1] + 60.0)
    assert metres < 8.0
    assert abs(azimuth) < math.radians(4.0)
    assert tilt < math.radians(2.0)


def test_velocities_that_contradict_good_positions_are_never_believed(drive) -> None:
    run, t = run_with(drive, v_e=3.0, v_n=-4.0, v_u=5.0)
    end = t[run.history.end.numpy()]
    inside = torch.from_numpy(
        (end >= FAULT[0]) & (end <= FAULT[1]) & (run.history.fix.numpy() >= 0)
    )
    verdicts = run.history.verdict[inside][:, InsKind.VELOCITY]
    assert (verdicts == int(Verdict.REFUSED_BY_GATE)).all()
    assert len(verdicts) > 40
    metres, azimuth, _ = errors_at(run, t, drive, FAULT[1])
    assert metres < 6.0
    assert abs(azimuth) < math.radians(3.0)


@pytest.mark.parametrize("positions", [True, False])
def test_all_blocks_at_once_equal_the_loop_through_a_minute_of_faults(drive, positions) -> None:
    wrong = {"v_e": 3.0, "v_n": -4.0, "v_u": 5.0}
    if positions:
        wrong |= {"lat": 3e-5, "lon": -4e-5, "height": 2.0}
    (quick, _), (exact, _) = (
        run_with(drive, method, (120.0, 180.0), **wrong) for method in ("fast", "exact")
    )
    found, oracle = quick.history, exact.history
    assert (found.method, oracle.method) == ("fast", "exact")
    assert (oracle.resets[InsKind.POSITION] > 0) == positions
    assert torch.equal(found.verdict, oracle.verdict)
    assert torch.equal(found.belief.refused, oracle.belief.refused)
    gap = state_difference(found.trajectory, oracle.trajectory).abs()
    assert float(gap[..., :3].max()) < 0.01
    for own, expected in ((found.prior, oracle.prior), (found.belief, oracle.belief)):
        sigma = expected.covariance.diagonal(dim1=-2, dim2=-1).sqrt()
        gap = (own.covariance - expected.covariance).abs()
        assert float((gap / sigma.unsqueeze(-1) / sigma.unsqueeze(-2)).max()) < 5e-3


def test_judging_all_blocks_at_once_equals_judging_them_in_turn() -> None:
    model = ins_filter_model(InsEkfOptions())
    draw = torch.Generator().manual_seed(3)
    shape = (4, 200, len(InsKind))
    nis = torch.rand(shape, generator=draw, dtype=torch.float64) * 30.0
    present = (torch.rand(shape, generator=draw) < 0.7).double()
    refused = torch.zeros(4, len(InsKind), dtype=torch.float64)
    together = judged_over_time(model, nis, present, refused)
    for k in range(shape[1]):
        one = judged(model, nis[:, k], present[:, k], refused)
        refused = one.refused
        assert torch.equal(one.verdict, together.verdict[:, k])
        seen = present[:, k] > 0.5
        assert torch.equal(refused[seen], together.refused[:, k][seen])
    assert (together.verdict == int(Verdict.ACCEPTED_BY_RESET)).any()
