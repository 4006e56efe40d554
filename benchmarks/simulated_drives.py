"""What ANARX does on simulated drives that nothing was chosen on, by sensor grade.

    python benchmarks/simulated_drives.py --drives 5

Per grade: mean of the maximum horizontal error of 60 s outages, and ANARX against the filter as
a ratio of means with an interval bootstrapped by drive.
"""

import argparse
import tempfile
import warnings
from multiprocessing import get_context
from pathlib import Path

import pandas as pd
import torch

from navlearn.experiment.drive import prepare_drive
from navlearn.experiment.methods import build_methods
from navlearn.logs.formats.native import save_log
from navlearn.logs.synthetic import simulate_drive
from navlearn.outages.replay import replay
from navlearn.outages.statistics import averages, compare
from navlearn.recipe import recipe_for

FIRST_SEED = 100
METHODS = ("dead_reckoning", "ekf", "anarx")


def one_drive(job: tuple[str, int, str]) -> pd.DataFrame:
    grade, seed, outages = job
    torch.set_num_threads(1)
    warnings.simplefilter("ignore")
    name = f"{grade}_{seed}"
    drive = simulate_drive(
        profile="mixed", grade=grade, duration=2000.0, seed=seed, imu_rate_hz=10.0, name=name
    )
    with tempfile.TemporaryDirectory() as folder:
        save_log(drive.log, Path(folder) / name)
        recipe = recipe_for(
            Path(folder) / name,
            outages=outages,
            methods=METHODS,
            outage_options={"warm_up_s": 600.0, "min_gap_s": 10.0},
        )
        ready = prepare_drive(recipe)
    found = replay(ready.log, ready.placement.outages, build_methods(recipe), progress=False)
    return found.rows.assign(grade=grade)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--grades", nargs="+", default=["mems_x", "mems_l", "mems_m", "tactical"])
    parser.add_argument("--drives", type=int, default=5, help="drives per grade")
    parser.add_argument("--outages", default="10x60")
    parser.add_argument("--processes", type=int, default=2)
    chosen = parser.parse_args()
    jobs = [
        (grade, FIRST_SEED + k, chosen.outages)
        for grade in chosen.grades
        for k in range(chosen.drives)
    ]
    with get_context("spawn").Pool(chosen.processes) as pool:
        rows = pd.concat(pool.imap(one_drive, jobs), ignore_index=True)
    print(
        f"{'grade':10} {'outages':>7}", *(f"{name:>15}" for name in METHODS), " anarx against ekf"
    )
    for grade in chosen.grades:
        part = rows[rows["grade"] == grade]
        means = [averages(part, name).mean for name in METHODS]
        one = compare(part, "anarx", "ekf")
        print(
            f"{grade:10} {one.pairs:7d}",
            *(f"{mean:15.2f}" for mean in means),
            f" {one.improvement_percent:+.1f} % ({one.low_percent:+.1f} to "
            f"{one.high_percent:+.1f}), better {one.wins}, equal {one.ties}, over 10 % worse "
            f"{one.harm_count}",
            flush=True,
        )


if __name__ == "__main__":
    main()
