"""Noise tuned by innovation likelihood: known noise, time, held-out likelihood, and outages.

python benchmarks/tuning.py                        # everything; scored seeds and real drives
python benchmarks/tuning.py --parts known time     # known noise from bad starts; an hour's drive

``known``: simulated drives whose errors are white and known, from the default noise and from ten
times and a tenth of it. ``time``: one hour at 10 Hz. ``simulated``: tuned on some seeds, judged on
others. ``css``, ``kingston``: tuned on what lies before the first outage, judged on the rest. Real
logs are looked for in $NAVLEARN_DATA or ../shared/data. Seconds are of the clock and of the
processor: the first depend on what else runs.
"""

import argparse
import dataclasses
import math
import tempfile
import time
from pathlib import Path

import pandas as pd
import torch

from navlearn.experiment.drive import prepare_drive
from navlearn.experiment.methods import build_methods
from navlearn.experiment.tuning import TuningResult, tune_recipe
from navlearn.experiment.tuning_drives import Stretch, own_stretch, whole_stretches
from navlearn.fusion.noise_options import NoiseOptions
from navlearn.fusion.options import EkfOptions
from navlearn.learning.drive_likelihood import TuningDrive
from navlearn.learning.noise_options import TuningOptions
from navlearn.learning.noise_tuning import TunedNoise, tune_noise
from navlearn.logs.resample import riss_timeline
from navlearn.logs.synthetic import simulate_drive
from navlearn.logs.synthetic.figures import GnssGrade, GyroGrade, OdometerGrade, SensorGrade
from navlearn.mechanization.options import RissOptions
from navlearn.outages.replay import replay
from navlearn.outages.statistics import averages, compare
from navlearn.recipe import Recipe, load_recipe
from navlearn.recipe.log_section import LogSource, SimulatedSection
from navlearn.recipe.sections import MechanizationSection, OutageSection

ROOT = Path(__file__).resolve().parents[1]
REAL = {"css": "css_riss", "kingston": "kingston_riss"}
PARTS = ("known", "time", "simulated", *REAL)
RATE = 10.0
WHITE = SensorGrade(
    name="white",
    summary="white errors and random walks alone",
    gyro=GyroGrade(
        bias_deg_per_s=0.1,
        rate_random_walk_deg_per_h_per_sqrt_h=60.0,
        angle_random_walk_deg_per_sqrt_h=1.2,
    ),
    odometer=OdometerGrade(scale_factor_percent=1.0),
    gnss=GnssGrade(noise=2.0, velocity_noise=0.1),
)
TRUTH = {
    "gyro_random_walk": math.radians(1.2) / 60.0,
    "gyro_bias_walk": math.radians(60.0) / 3600.0 / 60.0,
    "fix, east and north": 2.0,
    "fix, up": 3.2,
    "velocity of a fix": 0.1,
}
FLAT = RissOptions(dimensions=2)


def drive_of(grade: SensorGrade | str, seed: int, seconds: float) -> TuningDrive:
    log = simulate_drive(
        profile="mixed", grade=grade, duration=seconds, seed=seed, imu_rate_hz=RATE
    ).log
    line = riss_timeline(log, rate_hz=RATE)
    return TuningDrive(log.metadata.name, line.samples, line.fixes, line.timing)


def scaled(factor: float) -> EkfOptions:
    noise = {name: factor * value for name, value in vars(NoiseOptions()).items()}
    return EkfOptions(noise=NoiseOptions(**noise), mechanization=FLAT)


def timed(drives: list[TuningDrive], options: EkfOptions, steps: int) -> tuple[TunedNoise, float]:
    begun = time.process_time()
    found = tune_noise(drives, options, TuningOptions(iterations=steps), progress=False)
    return found, time.process_time() - begun


def show_known(args: argparse.Namespace) -> None:
    print("known noise: found with 95 % interval, and whether the truth lies inside")
    drive = drive_of(WHITE, args.known_seed, args.seconds)
    for factor in args.factors:
        found, used = timed([drive], scaled(factor), args.steps)
        figures = (*found.figures.entries, *found.figures.fixes)
        print(
            f"start x {factor:g}: {found.iterations} steps, gain {found.gain:.0f} nats in "
            f"{found.seconds:.0f} s of driving, {found.wall:.0f} s, processor {used:.0f} s"
        )
        for one in (figure for figure in figures if figure.name in TRUTH):
            truth, (low, high) = TRUTH[one.name], one.interval
            told = "inside" if low <= truth <= high else "outside"
            told = told if one.told else "not told"
            print(
                f"  {one.name:20s} {one.before:9.3g} -> {one.after:9.3g} "
                f"({low:.3g} to {high:.3g}) truth {truth:.3g} {told}"
            )


def show_time(args: argparse.Namespace) -> None:
    found, used = timed([drive_of("mems_m", args.known_seed, args.hour)], scaled(1.0), args.steps)
    print(
        f"time: {found.seconds:.0f} s of driving at {RATE:g} Hz, {len(found.values)} entries, "
        f"{found.iterations} steps in {found.rounds} rounds: {found.wall:.0f} s, processor "
        f"{used:.0f} s"
    )


def simulated_recipe(grade: str, seed: int, args: argparse.Namespace) -> Recipe:
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


def outage_rows(recipe: Recipe, result: TuningResult) -> pd.DataFrame:
    both = recipe.model_copy(
        update={"tuned": result.spec, "methods": ("ekf", "ekf+tuned"), "models": ()}
    )
    drive = prepare_drive(both)
    return replay(drive.log, drive.placement.outages, build_methods(both), progress=False).rows


def show_gain(name: str, result: TuningResult, rows: pd.DataFrame) -> None:
    gain = result.held_out
    if gain is not None:
        print(f"{name}: {gain.words}")
    found = compare(rows, "ekf+tuned", "ekf")
    mean = {method: averages(rows, method).mean for method in ("ekf", "ekf+tuned")}
    print(
        f"{name}: 60 s outages, largest error {mean['ekf']:.2f} -> {mean['ekf+tuned']:.2f} m, "
        f"{found.improvement_percent:+.1f} % ({found.low_percent:+.1f} to "
        f"{found.high_percent:+.1f}, 95 %, {found.pairs} outages by {found.drawn_by}); tuned in "
        f"{result.wall:.0f} s"
    )


def show_simulated(args: argparse.Namespace, folder: Path) -> None:
    options = TuningOptions(iterations=args.steps, spacing=args.spacing)
    for grade in args.grades:
        recipes = [simulated_recipe(grade, seed, args) for seed in args.tune_seeds]
        judging = [simulated_recipe(grade, seed, args) for seed in args.judge_seeds]
        stretches = whole_stretches(recipes, 0.0)
        for held in whole_stretches(judging, 0.0):
            stretches.append(dataclasses.replace(held, tuned_until=-math.inf))
        out = folder / f"{grade}.yaml"
        result = tune_recipe(recipes[0], stretches, out, tuning=options, progress=False)
        rows = pd.concat([outage_rows(recipe, result) for recipe in judging], ignore_index=True)
        show_gain(f"{grade}, seeds {args.tune_seeds} on {args.judge_seeds}", result, rows)


def show_real(name: str, args: argparse.Namespace, folder: Path) -> None:
    recipe = load_recipe(ROOT / "training" / f"{REAL[name]}.yaml")
    try:
        drive = prepare_drive(recipe)
    except OSError as problem:
        print(f"{name}: left out: {problem}")
        return
    own = own_stretch(recipe, 0.0)
    first = min(outage.start for outage in drive.placement.outages)
    whole = Stretch(log=drive.log, fingerprint=own.fingerprint, tuned_until=first)
    options = TuningOptions(iterations=args.steps, spacing=args.spacing)
    out = folder / f"{name}.yaml"
    result = tune_recipe(recipe, [whole], out, tuning=options, progress=False)
    show_gain(f"{name}, first {first:.0f} s on the rest", result, outage_rows(recipe, result))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--parts", nargs="+", choices=PARTS, default=PARTS)
    parser.add_argument("--seconds", type=float, default=1800.0, help="length of drives, s")
    parser.add_argument("--hour", type=float, default=3600.0, help="length of the timed drive, s")
    parser.add_argument("--steps", type=int, default=80, help="steps of a search at the most")
    parser.add_argument("--spacing", type=float, default=0.0, help="between fixes, s")
    parser.add_argument("--factors", nargs="+", type=float, default=[1.0, 10.0, 0.1])
    parser.add_argument("--known-seed", type=int, default=11)
    parser.add_argument("--grades", nargs="+", default=["mems_l", "mems_m", "tactical"])
    parser.add_argument("--tune-seeds", nargs="+", type=int, default=[11, 12])
    parser.add_argument("--judge-seeds", nargs="+", type=int, default=[141, 142, 143, 144])
    parser.add_argument("--outages", type=int, default=8)
    parser.add_argument("--warm-up", type=float, default=300.0)
    args = parser.parse_args()
    torch.set_num_threads(1)
    with tempfile.TemporaryDirectory() as folder:
        if "known" in args.parts:
            show_known(args)
        if "time" in args.parts:
            show_time(args)
        if "simulated" in args.parts:
            show_simulated(args, Path(folder))
        for name in REAL:
            if name in args.parts:
                show_real(name, args, Path(folder))


if __name__ == "__main__":
    main()
