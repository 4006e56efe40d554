"""Filters tuned on one simulated drive by differences or by Allan variance, judged on others.

python benchmarks/tuning_by_differences.py --grades mems_m mems_l tactical

Every filter is tuned on one drive and judged on two others. Columns: mean normalised innovation
squared per component of position and velocity (1 for an honest filter with white errors), root
mean square horizontal and azimuth error over the drive after its first minute, largest horizontal
error of 60 s outages (mean over outages, with its standard error), how much less that is than
untuned (mean over the same outages, with its standard error), and normalised error squared per
component at their ends (1 for an honest filter; more is too sure of itself).
"""

import argparse
from collections.abc import Callable
from typing import Any

import torch

from navlearn.errors import NavlearnError
from navlearn.fusion.options import EkfOptions
from navlearn.learning.allan_start import tuned_by_allan
from navlearn.learning.difference_tuning import tuned_by_differences
from navlearn.learning.integrated_errors import solution_errors
from navlearn.learning.referenced_drive import ReferencedDrive, referenced_drive
from navlearn.logs.drive_log import DriveLog
from navlearn.logs.resample import riss_timeline
from navlearn.logs.synthetic import simulate_drive
from navlearn.navigator import Navigator, NavigatorOptions, belief_at
from navlearn.recipe.filter_options import ekf_options
from navlearn.recipe.tuned_spec import TunedSpec
from navlearn.states import RissSample, Trajectory

BASE: dict[str, Any] = {"mechanization": {"dimensions": 2}}
RATE = 10.0
SETTLED, OUTAGE, EVERY = 600, 600, 900
FITTED_AND_JUDGED = ((11, (13, 14)), (13, (11, 12)))
COLUMNS = ("NIS pos", "NIS vel", "RMS m", "azimuth °", "60 s m", "± m", "less m", "± m", "NEES/2")

Drive = tuple[DriveLog, ReferencedDrive]
Rule = Callable[[Drive], dict[str, Any]]


def rules(options: EkfOptions) -> dict[str, Rule]:
    return {
        "untuned": lambda _: {},
        "allan": lambda one: tuned_by_allan(one[0]).filter,
        "increments": lambda one: tuned_by_differences([one[1]], options).filter,
        "increments, 5 s": lambda one: tuned_by_differences([one[1]], options, span=5.0).filter,
        "increments, white fixes": lambda one: (
            tuned_by_differences([one[1]], options, fix_errors="white").filter
        ),
        "ghouneem2024": lambda one: tuned_by_differences([one[1]], options, "ghouneem2024").filter,
        "ghouneem2024_absolute": lambda one: (
            tuned_by_differences([one[1]], options, "ghouneem2024_absolute").filter
        ),
    }


def drive(grade: str, seed: int, duration: float) -> Drive:
    log = simulate_drive(
        profile="mixed", grade=grade, duration=duration, seed=seed, imu_rate_hz=RATE
    ).log
    return log, referenced_drive(log, riss_timeline(log, rate_hz=RATE, dims=2))


def judged(one: ReferencedDrive, options: EkfOptions) -> tuple[list[float], list[float]]:
    """Return NIS, RMS and NEES figures of one drive, and its outages' largest errors."""
    navigator = Navigator(NavigatorOptions(filter=options))
    run = navigator.run(one.samples, one.fixes, one.timing)
    history = run.history
    truth = Trajectory(*(channel[run.first + 1 :] for channel in one.reference))
    errors = solution_errors(history.trajectory, truth)
    largest, nees = [], []
    for start in range(2 * SETTLED, len(run.samples.dt) - OUTAGE, EVERY):
        block = int(torch.searchsorted(history.end, torch.tensor(start)))
        there = slice(int(history.end[block]) + 1, int(history.end[block]) + 1 + OUTAGE)
        rest = RissSample(*(channel[there] for channel in run.samples))
        alone = navigator.filter_on(belief_at(history, block), rest, torch.zeros_like(rest.dt))
        off = solution_errors(alone.trajectory, Trajectory(*(channel[there] for channel in truth)))
        largest.append(float(torch.hypot(off.east, off.north).max()))
        end = torch.stack((off.east[-1], off.north[-1]))
        covariance = alone.belief.covariance[-1][:2, :2]
        nees.append(0.5 * float(end @ torch.linalg.solve(covariance, end)))
    figures = [
        _mean(history.nis[:, 0]) / 3.0,
        _mean(history.nis[:, 1]) / 2.0,
        _mean(errors.east[SETTLED:] ** 2 + errors.north[SETTLED:] ** 2) ** 0.5,
        float(torch.rad2deg(errors.azimuth[SETTLED:]).square().mean().sqrt()),
        sum(nees) / len(nees),
    ]
    return figures, largest


def _mean(values: torch.Tensor) -> float:
    return float(values[values.isfinite()].mean())


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--grades", nargs="+", default=["mems_m", "mems_l", "tactical"])
    parser.add_argument("--duration", type=float, default=1200.0, help="of each drive, s")
    arguments = parser.parse_args()
    torch.set_num_threads(1)
    before = ekf_options(BASE)
    for grade in arguments.grades:
        drives = {seed: drive(grade, seed, arguments.duration) for seed in (11, 12, 13, 14)}
        print(f"\n{grade:24}" + "".join(f"{name:>11}" for name in COLUMNS))
        untuned = torch.zeros(0)
        for name, rule in rules(before).items():
            figures, outages = [], list[float]()
            try:
                for fit, others in FITTED_AND_JUDGED:
                    found = rule(drives[fit])
                    spec = TunedSpec(filter=found) if found else None
                    options = ekf_options(spec.laid_over(BASE)) if spec else before
                    for seed in others:
                        row, largest = judged(drives[seed][1], options)
                        figures.append(row)
                        outages += largest
            except NavlearnError as problem:
                print(f"{name:24} no filter: {str(problem).split(':', 1)[1][:90].strip()}")
                continue
            *means, nees = (sum(column) / len(column) for column in zip(*figures, strict=True))
            spread = torch.tensor(outages)
            untuned = untuned if len(untuned) else spread
            less, root = untuned - spread, len(spread) ** 0.5
            shown = [
                *means,
                *(float(spread.mean()), float(spread.std()) / root),
                *(float(less.mean()), float(less.std()) / root),
                nees,
            ]
            print(f"{name:24}" + "".join(f"{value:11.3g}" for value in shown))


if __name__ == "__main__":
    main()
