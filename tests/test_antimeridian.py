"""A drive across the antimeridian, its longitudes wrapped: what it is a radian further west."""

import math
from dataclasses import replace

import numpy as np
import pytest
import torch

from navlearn.attitude import wrap_angle
from navlearn.fusion.error_state import initial_belief
from navlearn.fusion.first_guess import first_guess
from navlearn.fusion.ins.first_guess import told_by_fixes
from navlearn.fusion.ins.loosely_coupled import InsEkf
from navlearn.fusion.ins.timeline import ins_timeline
from navlearn.fusion.loosely_coupled import LooselyCoupledEkf
from navlearn.fusion.options import EkfOptions
from navlearn.fusion.timeline import timeline
from navlearn.ins_navigator import InsNavigator, InsNavigatorOptions
from navlearn.logs.drive_log import DriveLog
from navlearn.logs.imu_timeline import imu_timeline
from navlearn.logs.resample import riss_timeline
from navlearn.logs.synthetic import simulate_drive
from navlearn.mechanization.options import RissOptions
from navlearn.navigator import Navigator, NavigatorOptions
from navlearn.outages.metrics import errors_over_time
from navlearn.outages.schedule import Outage
from navlearn.outages.track import track_of
from navlearn.states import InsState, NavState

LAT = math.radians(-16.8)
WEST = 100.0 / (6.378e6 * math.cos(LAT))
PLANE = EkfOptions(mechanization=RissOptions(dimensions=2), zero_yaw_rate=False)
REPRESENTATIONS = {
    "wrapped": lambda lon: (lon + math.pi) % (2.0 * math.pi) - math.pi,
    "from Greenwich on": lambda lon: lon % (2.0 * math.pi),
}


def with_longitudes(log: DriveLog, change) -> DriveLog:
    tables = {}
    for name in ("fixes", "reference"):
        table = getattr(log, name)
        tables[name] = table.assign(lon=change(table["lon"].to_numpy()))
    return replace(log, **tables)


@pytest.fixture(scope="module")
def log() -> DriveLog:
    """A drive that starts 100 m west of the antimeridian."""
    origin = (LAT, math.pi - WEST, 20.0)
    return simulate_drive(
        profile="mixed", grade="mems_m", duration=160.0, seed=13, imu_rate_hz=20.0, origin=origin
    ).log


@pytest.fixture(scope="module")
def crossing(log: DriveLog) -> DriveLog:
    found = with_longitudes(log, REPRESENTATIONS["wrapped"])
    assert float(np.abs(np.diff(found.fixes["lon"])).max()) > 6.0
    return found


@pytest.fixture(scope="module")
def beside(log: DriveLog) -> DriveLog:
    """The same drive where longitude does not jump; only differences of longitude matter."""
    return with_longitudes(log, lambda lon: lon % (2.0 * math.pi) - 1.0)


def metres_apart(found, expected) -> float:
    """Return the largest distance of two paths, the second one a radian further west."""
    east = wrap_angle(found.lon - expected.lon - 1.0) * math.cos(LAT)
    return 6.378e6 * float(torch.hypot(east, found.lat - expected.lat).max())


@pytest.mark.parametrize("method", ["fast", "exact"])
def test_a_full_imu_filter_and_its_smoother_cross_it(crossing, beside, method):
    navigator = InsNavigator(InsNavigatorOptions(method=method))
    paths, passes = [], []
    for log in (crossing, beside):
        line = imu_timeline(log)
        with torch.no_grad():
            run = navigator.run(line.samples, line.fixes, line.timing)
            smoothed = navigator.smooth(run, line.fixes, line.timing)
        paths.append((run.history.trajectory, smoothed.trajectory))
        passes.append((run.history.passes, smoothed.passes))
    assert passes[0] == passes[1]
    for found, expected in zip(*paths, strict=True):
        assert metres_apart(found, expected) < 1e-3


@pytest.mark.parametrize("method", ["fast", "exact"])
def test_a_riss_filter_and_its_smoother_cross_it(crossing, beside, method):
    navigator = Navigator(NavigatorOptions(filter=PLANE, method=method))
    paths, passes = [], []
    for log in (crossing, beside):
        line = riss_timeline(log, rate_hz=10.0)
        with torch.no_grad():
            run = navigator.run(line.samples, line.fixes, line.timing)
            smoothed = navigator.smooth(run, line.fixes, line.timing)
        paths.append((run.history.trajectory, smoothed.trajectory))
        passes.append((run.history.passes, smoothed.passes))
    assert passes[0] == passes[1]
    for found, expected in zip(*paths, strict=True):
        assert metres_apart(found, expected) < 1e-3


def batched(line):
    parts = (line.samples, line.fixes, line.timing)
    return tuple(type(part)(*(x.unsqueeze(0) for x in part)) for part in parts)


def test_first_guesses_do_not_lead_round_the_earth(crossing, beside):
    """No result depends on them, but how soon it is found."""
    azimuth, told = [], []
    for log in (crossing, beside):
        riss, fixes, timing = batched(riss_timeline(log, rate_hz=10.0))
        where = tuple(x[:, 0] for x in fixes[:3])
        line = timeline(LooselyCoupledEkf(PLANE).model, riss, fixes, timing)
        start = initial_belief(PLANE, NavState(*where, 0.0 * where[0]))
        azimuth.append(first_guess(LooselyCoupledEkf(PLANE).model, start, line).state.azimuth)
        imu, fixes, timing = batched(imu_timeline(log))
        line = ins_timeline(InsEkf().model, imu, fixes, timing)
        still, level = torch.zeros(1, 3).double(), torch.tensor([[1.0, 0.0, 0.0, 0.0]]).double()
        told.append(told_by_fixes(InsState(*where, still, level), line, line.samples.dt.sum(-1))[0])
    torch.testing.assert_close(azimuth[0], azimuth[1], rtol=0, atol=1e-6)
    moved = told[1] + torch.tensor([0.0, 1.0, 0.0, 0.0, 0.0, 0.0]).double()
    torch.testing.assert_close(told[0], moved, rtol=0, atol=1e-6)


@pytest.mark.parametrize("solved", REPRESENTATIONS)
@pytest.mark.parametrize("known", REPRESENTATIONS)
def test_a_solution_is_scored_across_it(log, solved, known):
    outage = Outage(60.0, 60.0)
    names = ["t", "lat", "lon", "height", "v_e", "v_n", "azimuth"]
    # every third row between the reference's, so that positions are interpolated across it
    solution = log.reference[names].iloc[1::3].copy()
    solution["lon"] = REPRESENTATIONS[solved](solution["lon"].to_numpy())
    track = track_of(with_longitudes(log, REPRESENTATIONS[known]))
    found = errors_over_time(solution, track, outage)["horizontal"]
    straight = solution.assign(lon=solution["lon"].to_numpy() % (2.0 * math.pi) - 1.0)
    beside = track_of(with_longitudes(log, lambda lon: lon % (2.0 * math.pi) - 1.0))
    expected = errors_over_time(straight, beside, outage)["horizontal"]
    assert float(expected.max()) < 5.0
    np.testing.assert_allclose(found, expected, atol=1e-6)
