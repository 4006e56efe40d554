"""Receptions per second of the tightly coupled filter, beside the loosely coupled one.

    python benchmarks/tight_ekf.py                  # an hour, and 32 windows of 60 s
    python benchmarks/tight_ekf.py --minutes 5      # quick

A simulated drive at 100 Hz (mixed roads, MEMS IMU) that receives ten satellites once a second;
fixes, for alignment and for the loosely coupled filter, are solved from the same ranges. Windows
are stretches of it, each started from what the filter believed there. CPU seconds of one thread,
best of some repeats. Ratios: to the exact form of the same run, and to the same form of the loosely
coupled filter over the same samples. The backward pass of the exact form runs on a shorter stretch.
Differences are the largest of the positions at full rate from those of the exact form.
"""

import argparse
import resource
import time
from typing import Any, NamedTuple

import numpy as np
import torch
from torch import Tensor

from navlearn.filters.tight_belief import TightBelief, map_tree
from navlearn.frames import enu_between
from navlearn.fusion.ins.options import InsEkfOptions
from navlearn.fusion.options import EkfOptions
from navlearn.fusion.tight.history import TightHistory
from navlearn.ins_navigator import InsNavigator, InsNavigatorOptions
from navlearn.logs.imu_timeline import imu_timeline
from navlearn.logs.range_layout import RangeOptions
from navlearn.logs.range_tensors import ranges_of
from navlearn.logs.resample import riss_timeline
from navlearn.logs.synthetic import simulate_drive
from navlearn.logs.synthetic.satellite_options import SatelliteOptions
from navlearn.navigator import Navigator, NavigatorOptions
from navlearn.states import FixTiming, GnssFix, ImuSample, RissSample, SatelliteRanges
from navlearn.tight_navigator import TightNavigator, TightNavigatorOptions

RATE = 100
SATELLITES = 10
VEHICLES = {"riss": EkfOptions(), "imu": InsEkfOptions(states=15)}


class Work(NamedTuple):
    """What both filters run on, batch shape (B,), (B, T) and (B, M)."""

    start: TightBelief[Any]
    samples: RissSample | ImuSample
    ranges: SatelliteRanges
    timing: FixTiming
    fixes: GnssFix


class Filters(NamedTuple):
    """The two filters compared."""

    tight: Any
    loose: Any


def drive(seconds: int, kind: str) -> tuple[Filters, Work]:
    """Return filters and an aligned drive of one row."""
    log = simulate_drive(
        profile="mixed",
        grade="mems_m",
        duration=seconds + 120.0,
        seed=11,
        imu_rate_hz=float(RATE),
        satellites=SatelliteOptions(systems=("G", "E")),
    ).log
    line: Any = riss_timeline(log, rate_hz=RATE, dims=3) if kind == "riss" else imu_timeline(log)
    edges = np.concatenate(([line.start_time], line.t.numpy()))
    series = ranges_of(log, edges, RangeOptions())
    options = VEHICLES[kind]
    navigator = TightNavigator(TightNavigatorOptions(vehicle=options))
    found = navigator.align(line.samples, line.fixes, line.timing)
    first = found.sample + 1
    last = first + seconds * RATE
    ekf = navigator.filter(len(series.systems))
    start = ekf.start(navigator.start(found), series.ranges.has_range.shape[-1])
    rows = [
        part(tree, timing, first, last)
        for tree, timing in ((series.ranges, series.timing), (line.fixes, line.timing))
    ]
    ranges = rows[0][0]._replace(system=series.ranges.system)
    # ten at most: those that stand highest
    heard = torch.where(ranges.has_range > 0.5, ranges.elevation, -1.0)
    least = heard.sort(-1, descending=True).values[:, min(SATELLITES, heard.shape[-1]) - 1, None]
    kept = (heard >= least).to(heard)
    ranges = ranges._replace(has_range=ranges.has_range * kept, has_rate=ranges.has_rate * kept)
    samples = type(line.samples)(*(x[first:last] for x in line.samples))
    loose: Any
    if kind == "riss":
        loose = Navigator(NavigatorOptions(filter=VEHICLES["riss"])).filter  # type: ignore[arg-type]
    else:
        loose = InsNavigator(InsNavigatorOptions(filter=VEHICLES["imu"])).filter  # type: ignore[arg-type]
    work = Work(start, samples, ranges, rows[0][1], rows[1][0])
    return Filters(ekf, loose), map_tree(work, lambda x: x.unsqueeze(0))


def part(tree: Any, timing: FixTiming, first: int, last: int) -> tuple[Any, FixTiming]:
    """Return the fixes or receptions of a stretch."""
    inside = (timing.index >= first) & (timing.index < last)
    fields = zip(tree._fields, tree, strict=True)
    kept = type(tree)(*(x if name == "system" else x[inside] for name, x in fields))
    return kept, FixTiming(timing.index[inside] - first, timing.delay[inside])


def shortened(work: Work, seconds: int) -> Work:
    count = seconds * RATE
    keep = work.timing.index[0] < count
    ranges = (
        x if name == "system" else x[:, keep]
        for name, x in zip(work.ranges._fields, work.ranges, strict=True)
    )
    return Work(
        work.start,
        type(work.samples)(*(x[:, :count] for x in work.samples)),
        SatelliteRanges(*ranges),
        FixTiming(*(x[:, keep] for x in work.timing)),
        GnssFix(*(x[:, keep] for x in work.fixes)),
    )


def windows(filters: Filters, work: Work, seconds: int, count: int) -> Work:
    """Return stretches of a drive as a batch; each starts at a reception that was used."""
    with torch.no_grad():
        history = filters.tight(*work[:4], method="fast")
    length, most = seconds * RATE, history.end.shape[1] - seconds - 1
    places = [int(k) for k in torch.linspace(0, most - 1, count)]
    begin = [int(history.end[0, k]) + 1 for k in places]
    index = work.timing.index[0]
    chosen = [((index >= b) & (index < b + length)).nonzero()[:, 0] for b in begin]
    fewest = min(len(x) for x in chosen)
    rows = [(c[:fewest], slice(b, b + length), b) for c, b in zip(chosen, begin, strict=True)]

    def picked(tree: Any) -> Any:
        return type(tree)(
            *(
                x.expand(count, -1)
                if name == "system"
                else torch.stack([x[0, c] for c, _, _ in rows])
                for name, x in zip(tree._fields, tree, strict=True)
            )
        )

    timing = FixTiming(
        torch.stack([index[c] - b for c, _, b in rows]),
        torch.stack([work.timing.delay[0, c] for c, _, _ in rows]),
    )
    return Work(
        map_tree(history.belief, lambda x: torch.stack([x[0, k] for k in places])),
        type(work.samples)(*(torch.stack([x[0, s] for _, s, _ in rows]) for x in work.samples)),
        picked(work.ranges),
        timing,
        picked(work.fixes),
    )


def timed(
    filters: Filters, work: Work, tight: bool, method: str, backward: bool
) -> tuple[float, Any]:
    samples: Any = work.samples
    if backward:
        name = "yaw_rate" if isinstance(samples, RissSample) else "omega_ib_b"
        samples = samples._replace(**{name: getattr(samples, name).clone().requires_grad_()})
    begin = time.process_time()
    with torch.set_grad_enabled(backward):
        if tight:
            history = filters.tight(work.start, samples, work.ranges, work.timing, method=method)
        else:
            own = work.start.vehicle
            history = filters.loose(own, samples, work.fixes, work.timing, method=method)
        if backward:
            loss: Tensor = 6.4e6 * (history.trajectory.lat + history.trajectory.lon).mean()
            loss.backward()
    return time.process_time() - begin, history


def apart(history: TightHistory, exact: TightHistory | None) -> str:
    if exact is None or history.trajectory.lat.shape != exact.trajectory.lat.shape:
        return ""
    gap = torch.stack(enu_between(*history.trajectory[:3], *exact.trajectory[:3])).detach()
    return f", {float(gap.abs().amax()):.1e} m from exact"


def print_case(filters: Filters, name: str, work: Work, short: int, repeats: int) -> None:
    length = work.samples.dt.shape[-1] // RATE
    few = min(length, short)
    base, exact = 0.0, None
    jobs = [("exact", False, length), ("fast", False, length), ("fast", True, length)]
    for method, backward, seconds in [*jobs, ("exact", True, few)]:
        piece = work if seconds == length else shortened(work, seconds)
        count = 1 if method == "exact" and seconds > 600 else repeats
        rates, last = [], None
        for tight in (True, False):
            runs = [timed(filters, piece, tight, method, backward) for _ in range(count)]
            spent, history = min(runs, key=lambda r: r[0])
            rates.append((spent, piece.timing.index.numel() / spent))
            last = last or history
        (spent, rate), (_, loose) = rates
        base = base or rate
        exact = last if method == "exact" and not backward else exact
        peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
        label = method + (" forward+backward" if backward else " forward")
        heard = float(piece.ranges.has_range.sum(-1).mean())
        note = f"{seconds} s, {heard:.1f} satellites, {last.method}, {last.passes} passes"
        cells = f"{spent:8.3f} {rate:11.0f} {rate / base:8.2f} {rate / loose:8.2f}"
        print(
            f"{name:16} {label:22} {cells}  {note}{apart(last, exact)}, peak {peak:.0f} MB",
            flush=True,
        )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--minutes", type=int, default=60)
    parser.add_argument("--window", type=int, default=60, help="seconds of each window")
    parser.add_argument("--count", type=int, default=32, help="windows in the batch")
    parser.add_argument("--short", type=int, default=60, help="seconds of the slowest form")
    parser.add_argument("--vehicles", nargs="+", default=list(VEHICLES), choices=list(VEHICLES))
    parser.add_argument("--repeats", type=int, default=3)
    options = parser.parse_args()
    torch.set_num_threads(1)
    print(
        f"{'drive':16} {'form':22} {'CPU s':>8} {'receptions/s':>11} {'x exact':>8} "
        f"{'x loose':>8}  note"
    )
    for kind in options.vehicles:
        filters, work = drive(60 * options.minutes, kind)
        short, repeats = options.short, options.repeats
        print_case(filters, f"{kind}, {options.minutes} min", work, short, repeats)
        batch = windows(filters, work, options.window, options.count)
        name = f"{kind}, {options.count} x {options.window} s"
        print_case(filters, name, batch, short, repeats)


if __name__ == "__main__":
    main()
