"""The standstill detector on recorded drives: the IMU alone against odometer and reference.

Its limits come from physics and simulated drives; here it is only judged.
"""

from pathlib import Path
from typing import NamedTuple

import numpy as np
import pandas as pd
import pytest

from navlearn.logs.ins_standstill import standstill_intervals
from navlearn.logs.interval_means import interval_means, typical_period
from navlearn.logs.six_axes import ACCELEROMETERS, GYROS


class Recorded(NamedTuple):
    edges: np.ndarray
    rate: np.ndarray
    force: np.ndarray
    measured: np.ndarray
    speed: np.ndarray
    odometer: np.ndarray | None


class Score(NamedTuple):
    """Time standing still that was found; flags while faster than 0.5 m/s; delay in s."""

    found: float
    false: float
    delay: float
    stops: int


def recorded(folder: Path, truth: str, *, sampling="instant", late=0.0) -> Recorded:
    imu = pd.read_csv(folder / "imu.csv.gz")
    t = imu["t"].to_numpy()
    period = typical_period(t)
    edges = t[0] + np.arange(int((t[-1] - t[0]) / period) + 1) * period
    # Published forward, left, up.
    columns = [
        interval_means(t, imu[name].to_numpy(), edges, sampling=sampling)
        for name in (*GYROS, *ACCELEROMETERS)
    ]
    rate, force = np.stack(columns[:3], -1), np.stack(columns[3:], -1)
    measured = np.ones(edges.size - 1, dtype=bool)
    for k in np.flatnonzero(np.diff(t) > 3.5 * period):
        measured[(edges[1:] > t[k]) & (edges[:-1] < t[k + 1])] = False
    known = pd.read_csv(folder / f"{truth}.csv.gz").dropna(subset=["t"])
    speed = known["speed"] if truth == "odometer" else np.hypot(known["v_e"], known["v_n"])
    at = np.interp(edges[1:], known["t"] + late, speed, left=np.nan, right=np.nan)
    odometer = None
    if (folder / "odometer.csv.gz").is_file():
        told = pd.read_csv(folder / "odometer.csv.gz")
        odometer = interval_means(told["t"].to_numpy(), told["speed"].to_numpy(), edges)
    return Recorded(edges, rate, force, measured, at, odometer)


def score(drive: Recorded, *, with_odometer: bool = False) -> Score:
    period = float(drive.edges[1] - drive.edges[0])
    told = np.ones(drive.speed.size, dtype=bool) if with_odometer else None
    still = standstill_intervals(
        period,
        drive.rate,
        drive.force,
        measured=drive.measured,
        speed=drive.odometer if with_odometer else None,
        has_speed=told,
    )
    low = np.concatenate(([False], drive.speed < 0.05, [False]))
    starts, ends = (np.flatnonzero(np.diff(low.astype(int)) == sign) for sign in (1, -1))
    stops = [(a, b) for a, b in zip(starts, ends, strict=True) if (b - a) * period >= 2.0]
    parked = np.zeros(still.size, dtype=bool)
    for a, b in stops:
        parked[a:b] = True
    delays = [np.flatnonzero(still[a:b])[:1] * period for a, b in stops]
    delays = [float(d[0]) if d.size else np.inf for d in delays]
    return Score(
        float(still[parked].mean()) if stops else np.nan,
        float(still[drive.speed > 0.5].mean()),
        float(np.median(delays)) if stops else np.nan,
        len(stops),
    )


def test_kingston(data_folder):
    drive = recorded(data_folder("kingston_2008") / "csv", "reference", sampling="interval")
    alone, helped = score(drive), score(drive, with_odometer=True)
    assert alone.stops == helped.stops == 17
    assert alone.found > 0.95
    assert alone.false < 0.01  # it creeps at up to 1.5 m/s on wavelet-smoothed 10 Hz signals
    assert alone.delay < 1.2
    assert helped.found > 0.97
    assert helped.false == 0.0


def test_css(data_folder):
    drive = recorded(data_folder("css_obd_164") / "csv", "odometer", late=0.1)
    alone, helped = score(drive), score(drive, with_odometer=True)
    assert alone.stops == 3
    assert alone.found > 0.7
    assert alone.false < 0.001
    assert alone.delay < 2.5
    assert helped.found > 0.85
    assert helped.false < 1e-3


# Share of the time standing still (one stop each in two drives), and share of false flags.
KITTI = {
    "2011_09_30_drive_0018": (0.5, 0.001),
    "2011_09_30_drive_0020": (None, 0.002),
    "2011_09_30_drive_0027": (0.3, 0.001),
    "2011_09_30_drive_0028": (None, 0.001),
    "2011_09_30_drive_0033": (None, 0.001),
    "2011_09_30_drive_0034": (None, 0.01),
    "2011_10_03_drive_0042": (None, 0.001),
}


@pytest.mark.parametrize("name", KITTI)
def test_kitti(data_folder, name):
    found, false = KITTI[name]
    alone = score(recorded(data_folder("kitti_oxts") / "csv" / name, "reference"))
    assert alone.stops == (0 if found is None else 1)
    assert alone.false <= false
    if found is not None:
        assert alone.found > found


def test_comma(data_folder):
    alone = score(recorded(data_folder("comma2k19_example") / "csv", "odometer"))
    assert alone.stops == 0
    assert alone.false == 0.0
