"""Which fixes should take part in tuning by likelihood: outages by how far apart they are.

python benchmarks/tuning_spacing.py --grades mems_m mems_l

Noise is tuned on the first seeds and judged by outages on the others, the untuned filter being the
baseline. ``Q``: the entries of R stay as they are; ``all``: everything is free. Simulated fixes
have an error that lasts for a minute beside a white one.
"""

import argparse
import tempfile
import time
from pathlib import Path

import pandas as pd
import torch

from navlearn.experiment.baselines import FilterRuns, filter_options
from navlearn.experiment.drive import Drive, prepare_drive
from navlearn.experiment.methods import build_methods
from navlearn.experiment.tuning import tune_recipe
from navlearn.experiment.tuning_drives import whole_stretches
from navlearn.learning.noise_options import TuningOptions
from navlearn.learning.noise_parameters import FIX_ENTRIES, default_names
from navlearn.outages.replay import replay
from navlearn.outages.statistics import averages, compare
from navlearn.recipe import Recipe
from navlearn.recipe.log_section import LogSource, SimulatedSection
from navlearn.recipe.sections import MechanizationSection, OutageSection
from navlearn.recipe.tuned_spec import TunedSpec

RATE = 10.0


def recipe_of(grade: str, seed: int, args: argparse.Namespace) -> Recipe:
    made = SimulatedSection(
        grade=grade, duration_s=args.seconds, imu_rate_hz=RATE, seed=seed, profile="mixed"
    )
    return Recipe(
        name=f"{grade}_{seed}",
        log=LogSource(simulated=made),
        methods=("ekf",),
        mechanization=MechanizationSection(dims=2, rate_hz=RATE),
        outages=OutageSection(count=args.outages, duration_s=60.0, warm_up_s=args.warm_up),
    )


def rows_of(recipe: Recipe, drive: Drive, spec: TunedSpec | None) -> pd.DataFrame:
    method = "ekf" if spec is None else "ekf+tuned"
    asked = recipe.model_copy(update={"tuned": spec, "methods": (method,)})
    methods = build_methods(asked, runs=FilterRuns(asked, growing=True))
    return replay(drive.log, drive.placement.outages, methods, progress=False).rows


def free_names(recipe: Recipe, everything: bool) -> tuple[str, ...]:
    names = default_names(filter_options(recipe))
    return tuple(name for name in names if everything or name not in FIX_ENTRIES)


def show_grade(grade: str, args: argparse.Namespace, folder: Path) -> None:
    recipes = [recipe_of(grade, seed, args) for seed in args.tune_seeds]
    judging = [recipe_of(grade, seed, args) for seed in args.judge_seeds]
    stretches = whole_stretches(recipes, 0.0)
    drives = [prepare_drive(recipe) for recipe in judging]
    both = list(zip(judging, drives, strict=True))
    untuned = pd.concat([rows_of(recipe, drive, None) for recipe, drive in both])
    for everything in (False, True):
        for spacing in args.spacings:
            begun = time.monotonic()
            free = free_names(recipes[0], everything)
            options = TuningOptions(free=free, spacing=spacing, iterations=args.steps)
            out = folder / f"{grade}_{everything}_{spacing:g}.yaml"
            found = tune_recipe(recipes[0], stretches, out, tuning=options, progress=False)
            rows = [rows_of(recipe, drive, found.spec) for recipe, drive in both]
            told = compare(pd.concat([untuned, *rows]), "ekf+tuned", "ekf")
            mean = averages(pd.concat(rows), "ekf+tuned").mean
            noise = {name: f"{value:.2g}" for name, value in found.spec.filter["noise"].items()}
            print(
                f"{grade} {'all' if everything else 'Q':3s} spacing {spacing:3g} s: "
                f"{averages(untuned, 'ekf').mean:.2f} -> {mean:.2f} m, "
                f"{told.improvement_percent:+.1f} % ({told.low_percent:+.1f} to "
                f"{told.high_percent:+.1f}, {told.pairs} outages by {told.drawn_by}), "
                f"{time.monotonic() - begun:.0f} s",
                flush=True,
            )
            if args.noise:
                print("   ", noise, flush=True)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--grades", nargs="+", default=["mems_m", "mems_l"])
    parser.add_argument("--spacings", nargs="+", type=float, default=[0.0, 5.0, 10.0, 30.0])
    parser.add_argument("--seconds", type=float, default=1800.0, help="length of drives, s")
    parser.add_argument("--steps", type=int, default=80, help="steps of a search at the most")
    parser.add_argument("--tune-seeds", nargs="+", type=int, default=[11, 12])
    parser.add_argument("--judge-seeds", nargs="+", type=int, default=[13, 14, 15, 16])
    parser.add_argument("--outages", type=int, default=12)
    parser.add_argument("--warm-up", type=float, default=300.0)
    parser.add_argument("--noise", action="store_true", help="show what was found")
    args = parser.parse_args()
    torch.set_num_threads(1)
    with tempfile.TemporaryDirectory() as folder:
        for grade in args.grades:
            show_grade(grade, args, Path(folder))


if __name__ == "__main__":
    main()
