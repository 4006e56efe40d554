"""Single-point positions of recorded drives against what is known better.

    NAVLEARN_DATA=../shared/data python benchmarks/single_point.py

Judged against the reference of Kingston and smartLoc, the truth of a simulated drive (seed 11)
and the position in the header of the RINEX file. Solutions: equal weights without a test, default
weights without a test, with test and exclusion, with Huber's weights on what is left (the
default), the default with GPS alone where there are more systems, and the receiver's own fixes at
the same times (Kingston's are partly interpolated by their authors).

A reception is in a *canyon* where fewer than two satellites over 10° are to spare (fewer than six
of one system, seven of two), so that a fault could be seen but not excluded, or where their mean
C/N0 lies below 40 dB-Hz: a rule that looks at no error. Errors in m; velocities in m/s. The last
table is solutions per second of one thread, all receptions as one batch.
"""

import argparse
import gzip
import re
import time
import warnings
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import torch

from navlearn.errors import LogNotFoundError
from navlearn.frames import geodetic_from_ecef
from navlearn.gnss.range_noise import RangeNoiseOptions
from navlearn.gnss.range_rate_velocity import range_rate_velocity
from navlearn.gnss.single_point import single_point
from navlearn.gnss.single_point_options import SinglePointOptions
from navlearn.logs.drive_log import DriveLog
from navlearn.logs.quality.accuracy import errors_against
from navlearn.logs.range_layout import RangeOptions
from navlearn.logs.range_tensors import RangeSeries
from navlearn.logs.reading import read_log
from navlearn.logs.single_point_fixes import (
    ReceptionSolutions,
    SinglePointFixOptions,
    fixes_of,
    solve_receptions,
)
from navlearn.logs.synthetic import simulate_drive
from navlearn.logs.synthetic.satellite_options import SatelliteOptions

DATASETS = Path(__file__).resolve().parents[1] / "datasets"
LOGS = ("kingston_2008", "smartloc", "smartloc_rtklib", "rinex_static", "simulated")
SPARE, FAINT = 2, 40.0
EQUAL = RangeNoiseOptions(
    **dict.fromkeys(("ionosphere", "troposphere", "multipath", "thermal", "told_factor"), 0.0)
)
WAYS = {
    "equal weights": SinglePointOptions(noise=EQUAL, probability=1.0, huber=np.inf),
    "weighted": SinglePointOptions(probability=1.0, huber=np.inf),
    "and tested": SinglePointOptions(huber=np.inf),
    "and robust": SinglePointOptions(),
}
HEAD = f"{'part':8} {'solution':15} {'solved':>11} {'excl':>5} {'H 50':>7} {'H 95':>7} {'H max':>7}"
HEAD += f" {'V 50':>7} {'V 95':>7}  {'east':>7} {'north':>7} {'up':>7}"


def log_of(name: str, seconds: float) -> DriveLog:
    if name != "simulated":
        return read_log(DATASETS / f"{name}.yaml")
    sky = SatelliteOptions(systems="GE")
    return simulate_drive(duration=seconds, seed=11, imu_rate_hz=10.0, satellites=sky).log


def header_position(log: DriveLog) -> tuple[float, float, float]:
    """Return latitude, longitude (rad) and height (m) in the header of a RINEX file."""
    files = log.metadata.extra["files"]
    folder = Path(log.metadata.source.split(": ", 1)[1])
    with gzip.open(folder / files["ranges"], "rt") as lines:  # type: ignore[index]
        line = next(line for line in lines if "APPROX POSITION XYZ" in line)
    found = torch.tensor([float(x) for x in re.findall(r"[-\d.]+", line)[:3]], dtype=torch.float64)
    lat, lon, height = geodetic_from_ecef(found)
    return float(lat), float(lon), float(height)


def judged_by(log: DriveLog) -> pd.DataFrame:
    if log.reference is not None:
        return log.reference
    lat, lon, height = header_position(log)
    t = np.linspace(log.ranges["t"].iloc[0] - 1.0, log.ranges["t"].iloc[-1] + 1.0, 1000)
    return pd.DataFrame({"t": t, "lat": lat, "lon": lon, "height": height})


def in_canyon(series: RangeSeries) -> np.ndarray:
    ranges = series.ranges
    seen = (ranges.has_range > 0.0) & (ranges.elevation >= np.radians(10.0))
    systems = torch.stack(
        [(seen & (ranges.system == k)).any(-1) for k in range(len(series.systems))]
    ).sum(0)
    count = seen.sum(-1)
    cn0 = (ranges.cn0 * seen).sum(-1) / count.clamp_min(1)
    return ((count < 3 + systems + SPARE) | (cn0 < FAINT)).numpy()


def row(part: str, name: str, errors: np.ndarray, of: int, excluded: float) -> str:
    level = np.hypot(errors[0], errors[1])
    if not level.size:
        return f"{part:8} {name:15} {0:5d}/{of:5d}"
    h, v = (np.quantile(x, (0.5, 0.95, 1.0)) for x in (level, np.abs(errors[2])))
    means = " ".join(f"{x:7.2f}" for x in np.median(errors, axis=1))
    return (
        f"{part:8} {name:15} {level.size:5d}/{of:5d} {excluded:5.0f} {h[0]:7.2f} {h[1]:7.2f} "
        f"{h[2]:7.2f} {v[0]:7.2f} {v[1]:7.2f}  {means}"
    )


def parts_of(canyon: np.ndarray) -> Iterator[tuple[str, np.ndarray]]:
    yield "all", np.ones(canyon.size, dtype=bool)
    if canyon.any() and not canyon.all():
        yield "open", ~canyon
        yield "canyon", canyon


def show_positions(log: DriveLog, solutions: dict[str, ReceptionSolutions]) -> None:
    reference = judged_by(log)
    first = next(iter(solutions.values()))
    t = first.series.t.numpy()
    canyon = in_canyon(first.series)
    print(
        f"{np.mean(canyon):.0%} of the receptions in canyons, {len(first.series.systems)} systems"
    )
    print(HEAD)
    for part, inside in parts_of(canyon):
        for name, found in solutions.items():
            ok = found.points.ok.numpy()
            errors = np.array(errors_against(fixes_of(found), reference)[1:])
            kept = inside[ok] & np.isfinite(errors).all(0)
            excluded = float(found.points.excluded[torch.from_numpy(inside)].sum())
            print(row(part, name, errors[:, kept], int(inside.sum()), excluded))
        near = [np.flatnonzero(np.abs(t[inside] - at) < 0.05).size > 0 for at in log.fixes["t"]]
        own = log.fixes[np.array(near, dtype=bool)]
        if len(own):
            errors = np.array(errors_against(own, reference)[1:])
            errors = errors[:, np.isfinite(errors).all(0)]
            print(row(part, "receiver's own", errors, int(inside.sum()), np.nan))


def show_velocities(log: DriveLog, found: ReceptionSolutions) -> None:
    fixes = fixes_of(found)
    if "v_e" not in fixes:
        print("no range rates: no velocities")
        return
    reference = log.reference
    off = []
    for name in ("v_e", "v_n", "v_u"):
        known = reference is not None and name in reference
        truth = np.interp(fixes["t"], reference["t"], reference[name]) if known else 0.0
        off.append(fixes[name].to_numpy() - truth)
    error = np.linalg.norm(np.array(off)[:2], axis=0)
    error = error[np.isfinite(error)]
    median, most = np.quantile(error, (0.5, 0.95))
    print(f"velocities: {error.size} solved, horizontal 50 % {median:.3f}, 95 % {most:.3f} m/s")


def speed(series: RangeSeries, options: SinglePointOptions, repeat: int) -> tuple[float, float]:
    """Return positions, and velocities, per second."""
    best = [np.inf, np.inf]
    with torch.no_grad():
        for _ in range(repeat):
            start = time.perf_counter()
            points = single_point(series.ranges, options)
            middle = time.perf_counter()
            range_rate_velocity(series.ranges, (points.lat, points.lon, points.height), options)
            best = [min(best[0], middle - start), min(best[1], time.perf_counter() - middle)]
    return len(series.t) / best[0], len(series.t) / best[1]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--logs", nargs="+", default=LOGS, choices=LOGS)
    parser.add_argument("--repeat", type=int, default=5)
    parser.add_argument("--seconds", type=float, default=600.0, help="length of the simulated one")
    wanted = parser.parse_args()
    torch.set_num_threads(1)
    warnings.simplefilter("ignore")
    rates = []
    for name in wanted.logs:
        try:
            log = log_of(name, wanted.seconds)
        except LogNotFoundError as error:
            print(f"{name}: left out ({error})\n")
            continue
        print(name)
        options = {way: SinglePointFixOptions(single_point=own) for way, own in WAYS.items()}
        solutions = {way: solve_receptions(log, own) for way, own in options.items()}
        tested = solutions["and robust"]
        if len(tested.series.systems) > 1:
            alone = replace(options["and robust"], ranges=RangeOptions(systems="G"))
            solutions["GPS alone"] = solve_receptions(log, alone)
        show_positions(log, solutions)
        show_velocities(log, tested)
        print()
        for way, own in WAYS.items():
            rates.append((name, way, *tested.series.ranges.pseudorange.shape))
            rates[-1] += speed(tested.series, own, wanted.repeat)
    print(f"{'log':16} {'solution':14} {'M':>5} {'S':>4} {'positions/s':>12} {'velocities/s':>13}")
    for name, way, receptions, satellites, positions, velocities in rates:
        print(
            f"{name:16} {way:14} {receptions:5d} {satellites:4d} {positions:12.0f} "
            f"{velocities:13.0f}"
        )


if __name__ == "__main__":
    main()
