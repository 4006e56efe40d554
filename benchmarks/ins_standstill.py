"""How well standstill is told on recorded drives: by the IMU alone, and with an odometer.

    NAVLEARN_DATA=../shared/data python benchmarks/ins_standstill.py

Truth is the reference's speed or, without one, the odometer's. A stop lasts two seconds or more
below 0.05 m/s. Per log: how many stops there are and were found, share of the time standing that
was found, share of the samples faster than 0.5 m/s that were called still, and the median delay.
"""

import argparse
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import numpy as np

from navlearn.errors import LogNotFoundError
from navlearn.logs.drive_log import DriveLog
from navlearn.logs.imu_timeline import ImuTimelineOptions, imu_timeline
from navlearn.logs.reading import read_log

DATASETS = Path(__file__).resolve().parents[1] / "datasets"
KITTI = [f"kitti_00{number}" for number in (18, 20, 27, 28, 33, 34, 42)]
LOGS = ["kingston_2008_csv", "css_obd_164_csv", *KITTI, "comma2k19_example_csv"]
STANDING, MOVING, SHORTEST = 0.05, 0.5, 2.0
GAP = 2.5


class Score(NamedTuple):
    """Columns of the table; shares in %, times in s."""

    stops: int
    seconds: float
    seen: int
    found: float
    false: float
    delay: float


def true_speed(log: DriveLog, t: np.ndarray) -> np.ndarray:
    table = log.odometer if log.reference is None else log.reference
    at = table["t"].to_numpy()
    known = "speed" in table
    speed = table["speed"] if known else np.hypot(table["v_e"], table["v_n"])
    found = np.interp(t, at, np.abs(speed), left=np.nan, right=np.nan)
    right = np.clip(np.searchsorted(at, t), 1, at.size - 1)
    return np.where(at[right] - at[right - 1] > GAP, np.nan, found)


def stops_of(speed: np.ndarray, period: float) -> list[slice]:
    low = np.concatenate(([False], speed < STANDING, [False])).astype(int)
    edges = zip(np.flatnonzero(np.diff(low) > 0), np.flatnonzero(np.diff(low) < 0), strict=True)
    return [slice(a, b) for a, b in edges if (b - a) * period >= SHORTEST]


def score(log: DriveLog, speed_of: DriveLog) -> Score:
    line = imu_timeline(log, options=ImuTimelineOptions(max_imu_gap=3.0))
    still, t = line.samples.stationary.numpy() > 0.5, line.t.numpy()
    period, speed = float(line.samples.dt[0]), true_speed(speed_of, t)
    stops = stops_of(speed, period)
    first = [np.flatnonzero(still[stop])[:1] * period for stop in stops]
    seen = [float(delay[0]) for delay in first if delay.size]
    parked = np.concatenate([still[stop] for stop in stops]) if stops else np.empty(0)
    return Score(
        len(stops),
        parked.size * period,
        len(seen),
        100.0 * float(parked.mean()) if stops else np.nan,
        100.0 * float(still[speed > MOVING].mean()),
        float(np.median(seen)) if seen else np.nan,
    )


def show(name: str, log: DriveLog) -> None:
    variants = {"IMU alone": replace(log, odometer=log.odometer.iloc[:0])}
    if len(log.odometer):
        variants["and odometer"] = log
    for kind, variant in variants.items():
        s = score(variant, log)
        print(
            f"{name:24s} {kind:13s} {s.stops:5d} {s.seconds:7.0f} {s.seen:6d} {s.found:8.1f} "
            f"{s.false:9.3f} {s.delay:8.2f}"
        )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--logs", nargs="+", default=LOGS)
    arguments = parser.parse_args()
    print(f"{'log':38s} stops  time s  found  found %   false %  delay s")
    for name in arguments.logs:
        try:
            log = read_log(DATASETS / f"{name}.yaml")
        except LogNotFoundError as error:
            print(f"{name:24s} left out: {str(error).splitlines()[0]}")
            continue
        show(name, log)


if __name__ == "__main__":
    main()
