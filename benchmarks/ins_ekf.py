"""Speed of the three forms of the full-IMU filter, forward and backward, and how far they differ.

    python benchmarks/ins_ekf.py                  # an hour at 100 Hz, and 32 windows of 60 s
    python benchmarks/ins_ekf.py --minutes 5      # quick

A simulated drive (mixed roads, MEMS IMU, a fix per second, odometer), aligned by the navigator;
windows are stretches of it, each started from what the filter believed there. CPU seconds of one
thread, best of some repeats; ratios are to the exact form of the same run. The sequential form and
the backward pass of the exact form run on a shorter stretch. Differences are the largest of the
positions at full rate from those of the exact form over the same stretch.
"""

import argparse
import resource
import time
from typing import NamedTuple

import torch
from torch import Tensor

from navlearn.filters.ins_belief import InsBelief, map_ins_belief
from navlearn.fusion.ins.history import InsHistory
from navlearn.fusion.ins.layout import state_difference
from navlearn.fusion.ins.loosely_coupled import InsEkf
from navlearn.fusion.ins.options import InsEkfOptions
from navlearn.ins_navigator import InsNavigator, InsNavigatorOptions
from navlearn.logs.imu_timeline import imu_timeline
from navlearn.logs.synthetic import simulate_drive
from navlearn.states import FixTiming, GnssFix, ImuSample

RATE = 100


class Work(NamedTuple):
    """What a filter runs on, batch shape (B,), (B, T) and (B, M)."""

    start: InsBelief
    samples: ImuSample
    fixes: GnssFix
    timing: FixTiming


def drive(seconds: int, states: int) -> tuple[InsEkf, Work]:
    """Return a filter and an aligned drive of one row."""
    log = simulate_drive(
        profile="mixed", grade="mems_m", duration=seconds + 120.0, seed=11, imu_rate_hz=float(RATE)
    ).log
    line = imu_timeline(log)
    navigator = InsNavigator(InsNavigatorOptions(filter=InsEkfOptions(states=states)))
    found = navigator.align(line.samples, line.fixes, line.timing)
    first, last = found.sample + 1, found.sample + 1 + seconds * RATE
    samples = ImuSample(*(x[None, first:last] for x in line.samples))
    keep = (line.timing.index >= first) & (line.timing.index < last)
    fixes = GnssFix(*(x[None, keep] for x in line.fixes))
    timing = FixTiming(line.timing.index[None, keep] - first, line.timing.delay[None, keep])
    start = map_ins_belief(navigator.start(found), lambda x: x.unsqueeze(0))
    return navigator.filter, Work(start, samples, fixes, timing)


def shortened(work: Work, seconds: int) -> Work:
    count = seconds * RATE
    keep = work.timing.index[0] < count
    return Work(
        work.start,
        ImuSample(*(x[:, :count] for x in work.samples)),
        GnssFix(*(x[:, keep] for x in work.fixes)),
        FixTiming(*(x[:, keep] for x in work.timing)),
    )


def windows(ekf: InsEkf, work: Work, seconds: int, count: int) -> Work:
    """Return stretches of a drive as a batch; each starts at a fix that the filter has used."""
    with torch.no_grad():
        history = ekf(*work, method="fast")
    length, most = seconds * RATE, history.end.shape[1] - seconds - 1
    places = [int(k) for k in torch.linspace(0, most - 1, count)]
    begin = [int(history.end[0, k]) + 1 for k in places]
    inside = [(work.timing.index[0] >= b) & (work.timing.index[0] < b + length) for b in begin]
    fewest = min(int(x.sum()) for x in inside)
    chosen = [x.nonzero()[:fewest, 0] for x in inside]
    return Work(
        map_ins_belief(history.belief, lambda x: torch.stack([x[0, k] for k in places])),
        ImuSample(*(torch.stack([x[0, b : b + length] for b in begin]) for x in work.samples)),
        GnssFix(*(torch.stack([x[0, c] for c in chosen]) for x in work.fixes)),
        FixTiming(
            torch.stack([work.timing.index[0, c] - b for c, b in zip(chosen, begin, strict=True)]),
            torch.stack([work.timing.delay[0, c] for c in chosen]),
        ),
    )


def timed(ekf: InsEkf, work: Work, method: str, backward: bool) -> tuple[float, InsHistory]:
    samples = work.samples
    if backward:
        omega, force = (x.clone().requires_grad_() for x in (samples.omega_ib_b, samples.f_b))
        samples = samples._replace(omega_ib_b=omega, f_b=force)
    begin = time.process_time()
    with torch.set_grad_enabled(backward):
        history = ekf(work.start, samples, work.fixes, work.timing, method=method)
        if backward:
            path = history.trajectory
            loss: Tensor = 6.4e6 * (path.lat + path.lon).mean() + path.v_l.mean()
            loss.backward()
    return time.process_time() - begin, history


def apart(history: InsHistory, exact: InsHistory | None) -> str:
    if exact is None or history.trajectory.lat.shape != exact.trajectory.lat.shape:
        return ""
    gap = state_difference(history.trajectory, exact.trajectory)[..., :3].detach()
    return f", {float(gap.abs().amax()):.1e} m from exact"


def print_case(ekf: InsEkf, name: str, work: Work, short: int, repeats: int) -> None:
    length = work.samples.dt.shape[-1] // RATE
    few = min(length, short)
    jobs = [("exact", False, length), ("fast", False, length), ("fast", True, length)]
    jobs += [("sequential", False, few), ("exact", False, few), ("fast", False, few)]
    jobs.append(("exact", True, few))
    base, exact = 0.0, None
    for method, backward, seconds in jobs:
        part = work if seconds == length else shortened(work, seconds)
        count = 1 if method == "sequential" or (method == "exact" and seconds > 600) else repeats
        runs = [timed(ekf, part, method, backward) for _ in range(count)]
        spent, history = min(runs, key=lambda r: r[0])
        if method == "sequential":
            sequential = history
        rate = part.samples.dt.numel() / spent / 1e6
        base = base or rate
        if method == "exact" and not backward:
            exact = history
        note = f"{seconds} s, {history.method}, {history.passes} passes{apart(history, exact)}"
        if method == "exact" and seconds == few and not backward and few < length:
            note += f"; sequential{apart(sequential, exact)}"
        peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
        label = method + (" forward+backward" if backward else " forward")
        cells = f"{spent:8.3f} {rate:8.4f} {rate / base:8.2f}"
        print(f"{name:20} {label:23} {cells}  {note}, peak {peak:.0f} MB", flush=True)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--minutes", type=int, default=60)
    parser.add_argument("--window", type=int, default=60, help="seconds of each window")
    parser.add_argument("--count", type=int, default=32, help="windows in the batch")
    parser.add_argument("--short", type=int, default=30, help="seconds of the slow forms")
    parser.add_argument("--states", type=int, nargs="+", default=[15, 21], choices=(9, 15, 21))
    parser.add_argument("--repeats", type=int, default=3)
    options = parser.parse_args()
    torch.set_num_threads(1)
    print(f"{'drive':20} {'form':23} {'CPU s':>8} {'M/s':>8} {'x exact':>8}  note")
    for states in options.states:
        ekf, work = drive(60 * options.minutes, states)
        name = f"{states} states"
        short, repeats = options.short, options.repeats
        print_case(ekf, f"{name}, {options.minutes} min", work, short, repeats)
        batch = windows(ekf, work, options.window, options.count)
        print_case(ekf, f"{name}, {options.count} x {options.window} s", batch, short, repeats)


if __name__ == "__main__":
    main()
