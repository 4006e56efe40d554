"""The loosely coupled full-IMU filter beside the feedback filter of pyins, in one run.

Both filters have 15 states and are told the same start, the same deviations and noise densities,
and the same fixes of position and velocity once a second; nothing else (no odometer, no standstill,
no gate). pyins carries its covariance once a second: a tenth of a second moves its errors by 3 %
and takes six times as long. A lever arm of a metre stands between IMU and antenna.

Drives: simulated ones whose sensors have more errors than 15 states know, with four outages of
60 s. Errors are estimate minus truth: root mean squares over all seconds after the first two
minutes, the greatest horizontal error of each outage (m), the mean NEES over degrees of freedom.
Honesty: one drive with noise that is exactly what the filters are told, drawn anew for every run;
the mean NEES of all runs at one time beside the band in which 95 % of honest filters lie, and the
share of all seconds in it. An outage of 60 s begins when the filter has settled, or long before.
Speed: CPU seconds of one thread. Command:

    python benchmarks/pyins_filter.py [--seconds 900] [--grades mems_m tactical]
        [--seeds 11 12 13] [--runs 20] [--methods exact fast]

pyins is installed by: pip install git+https://github.com/nmayorov/pyins
"""

import argparse
import importlib.util
import warnings

import torch
from beside_pyins.filters import BLOCKS, errors_of, normalised_squares, run_navlearn, run_pyins
from beside_pyins.frames import MISSING
from beside_pyins.work import OUTAGE, TOLD, drawn, simulated

from navlearn.filters.consistency import mean_band

SETTLED = 120


def run_all(work, methods):
    """Return what every filter found, by name."""
    return {"pyins": run_pyins(work), **{m: run_navlearn(work, m) for m in methods}}


def print_drive(work, results, outages):
    titles = ("position, m", "height, m", "velocity, m/s", "tilt, °", "azimuth, °")
    shown = " ".join([*titles, *(f"  {begin} s" for begin in outages)])
    print(f"{'':10} {shown}  NEES: position velocity attitude    CPU s  samples/s  x pyins")
    for name, found in results.items():
        error = errors_of(work, found)[0]
        t = (found.index + 1) * work.samples.dt[0, 0]
        later = t > SETTLED
        square = error[later].square().mean(0)
        figures = (
            square[:2].sum().sqrt(),
            square[2].sqrt(),
            square[3:6].sum().sqrt(),
            square[6:8].sum().sqrt().rad2deg(),
            square[8].sqrt().rad2deg(),
        )
        row = [f"{x:{len(title)}.3f}" for x, title in zip(figures, titles, strict=True)]
        flat = error[:, :2].norm(dim=-1)
        for begin in outages:
            row.append(f"{flat[(t >= begin) & (t < begin + OUTAGE)].max():7.2f}")
        squares = normalised_squares(work, found)
        row.append(f"{squares['position'][0, later].mean():15.2f}")
        row += [f"{squares[block][0, later].mean():8.2f}" for block in ("velocity", "attitude")]
        row.append(f"{found.spent:8.2f} {work.samples.dt.shape[1] / found.spent:10.0f}")
        print(f"{name:10} {' '.join(row)} {results['pyins'].spent / found.spent:8.1f}")


def print_honesty(runs, seconds, begin, methods):
    work = drawn(runs, seconds, [begin])
    results = run_all(work, methods)
    end = begin + OUTAGE
    times = (30, begin - 1, begin + 30, end - 1, end, end + 5, end + 10, seconds - 1)
    print(f"\nnoise as told, {runs} runs, outage from {begin} to {end} s: mean NEES")
    print(f"{'':27}{'95 % band':>13} " + "".join(f"{f'{s} s':>8}" for s in times) + "   inside")
    for block, part in BLOCKS.items():
        degrees = part.stop - part.start
        low, high = (x / degrees for x in mean_band(degrees, runs))
        for name, found in results.items():
            mean = normalised_squares(work, found)[block].mean(0)
            t = (found.index + 1) * work.samples.dt[0, 0]
            shown = "".join(f"{mean[(t - s).abs().argmin()]:8.2f}" for s in times)
            share = ((mean > low) & (mean < high)).to(mean).mean()
            print(f"{block:12} {name:12} {low:7.2f} {high:6.2f} {shown} {share:8.0%}")


def main():
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seconds", type=int, default=900)
    parser.add_argument("--grades", nargs="*", default=["mems_m", "tactical"], choices=sorted(TOLD))
    parser.add_argument("--seeds", type=int, nargs="*", default=[11, 12, 13])
    parser.add_argument("--runs", type=int, default=20, help="0 leaves honesty out")
    parser.add_argument("--methods", nargs="*", default=["exact", "fast"])
    args = parser.parse_args()
    if importlib.util.find_spec("pyins") is None:
        print(MISSING)
        return
    torch.set_num_threads(1)
    warnings.simplefilter("ignore")  # pandas tells pyins of what it will drop
    run_pyins(simulated("mems_m", 11, 40, []))  # compiles it
    outages = list(range(args.seconds // 3, args.seconds - OUTAGE - 30, 150))[:4]
    for grade in args.grades:
        for seed in args.seeds:
            print(f"\n{grade}, seed {seed}, {args.seconds} s at 100 Hz")
            work = simulated(grade, seed, args.seconds, outages)
            print_drive(work, run_all(work, args.methods), outages)
    if args.runs:
        print_honesty(args.runs, 300, 180, args.methods)
        print_honesty(args.runs, 130, 40, args.methods)


if __name__ == "__main__":
    main()
