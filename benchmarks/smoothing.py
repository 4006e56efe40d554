"""What smoothing gains in outages of simulated drives, and what it costs.

    python benchmarks/smoothing.py --seeds 11 12 13

Per grade: mean over the outages of the largest error by the filter and by `rts`, horizontal,
azimuth and velocity, and how often smoothing was over 10 % worse. Then one drive of an hour:
seconds of the filter, and of the smoother in turn and parallel in time, on the same linear steps.
"""

import argparse
import tempfile
import time
import warnings
from pathlib import Path

import pandas as pd
import torch

from navlearn.experiment.drive import prepare_drive
from navlearn.experiment.methods import build_methods
from navlearn.filters.scan import LinearSteps, filter_in_parallel
from navlearn.filters.smoother import forward_pass, smooth_in_parallel, smooth_in_turn
from navlearn.logs.formats.native import save_log
from navlearn.logs.synthetic import simulate_drive
from navlearn.outages.replay import replay
from navlearn.recipe import recipe_for

METHODS = ("ekf", "rts")
SHOWN = {
    "horizontal m": "max_horizontal_error_m",
    "azimuth deg": "max_azimuth_error_deg",
    "velocity m/s": "max_velocity_error_m_per_s",
}


def drive_rows(grade: str, seed: int, outages: str, folder: Path) -> pd.DataFrame:
    name = f"{grade}_{seed}"
    if not (folder / name).exists():
        drive = simulate_drive(
            profile="mixed", grade=grade, duration=2400.0, seed=seed, imu_rate_hz=10.0, name=name
        )
        save_log(drive.log, folder / name)
    recipe = recipe_for(
        folder / name,
        outages=outages,
        methods=METHODS,
        outage_options={"warm_up_s": 600.0, "min_gap_s": 10.0},
    )
    ready = prepare_drive(recipe)
    found = replay(ready.log, ready.placement.outages, build_methods(recipe), progress=False)
    return found.rows


def show_gain(grade: str, outages: str, rows: pd.DataFrame) -> None:
    mean = rows.groupby("method")[list(SHOWN.values())].mean()
    pairs = rows.pivot_table(
        index=["drive", "outage"], columns="method", values="max_horizontal_error_m"
    )
    worse = int((pairs["rts"] > 1.1 * pairs["ekf"]).sum())
    cells = []
    for column in SHOWN.values():
        before, after = float(mean.loc["ekf", column]), float(mean.loc["rts", column])
        cells.append(f"{before:7.2f} {after:6.2f} {100.0 * (1.0 - after / before):4.0f} %")
    print(f"{grade:9} {outages:6} {len(pairs):4d} ", "  ".join(cells), f" {worse:3d}", flush=True)


def show_cost(count: int, repeats: int) -> None:
    generator = torch.Generator().manual_seed(0)
    n, r = 7, 6

    def draw(*shape: int) -> torch.Tensor:
        return torch.randn(count, *shape, generator=generator, dtype=torch.float64)

    eye = torch.eye(n, dtype=torch.float64)
    steps = LinearSteps(
        eye + 0.05 * draw(n, n), draw(n), 0.1 * eye.expand(count, n, n), draw(r, n),
        torch.ones(count, r, dtype=torch.float64), draw(r),
    )  # fmt: skip
    start = torch.zeros(n, dtype=torch.float64), eye
    filtered = filter_in_parallel(*start, steps)
    forward = forward_pass(*start, steps, filtered)
    work = {
        "filter, parallel": lambda: filter_in_parallel(*start, steps),
        "smoother, in turn": lambda: smooth_in_turn(forward),
        "smoother, parallel": lambda: smooth_in_parallel(forward),
    }
    with torch.no_grad():
        for name, function in work.items():
            taken = []
            for _ in range(repeats):
                begin = time.perf_counter()
                function()
                taken.append(time.perf_counter() - begin)
            print(f"{name:20} {count} steps of {n} states: {1e3 * min(taken):8.1f} ms")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--grades", nargs="+", default=["mems_x", "mems_l", "mems_m", "tactical"])
    parser.add_argument("--seeds", nargs="+", type=int, default=[11, 12, 13])
    parser.add_argument("--outages", nargs="+", default=["10x60", "7x120"])
    parser.add_argument("--steps", type=int, default=3600)
    parser.add_argument("--repeats", type=int, default=3)
    chosen = parser.parse_args()
    torch.set_num_threads(1)
    warnings.simplefilter("ignore")
    show_cost(chosen.steps, chosen.repeats)
    heads = "  ".join(f"{name:>12}: ekf rts" for name in SHOWN)
    print(f"{'grade':9} {'':6} {'n':>4} ", heads, " worse")
    with tempfile.TemporaryDirectory() as folder:
        for outages in chosen.outages:
            for grade in chosen.grades:
                rows = [drive_rows(grade, seed, outages, Path(folder)) for seed in chosen.seeds]
                show_gain(grade, outages, pd.concat(rows))


if __name__ == "__main__":
    main()
