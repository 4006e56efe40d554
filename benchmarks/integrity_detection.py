"""Which faults of known size are caught, how many good fixes are taken for faults, at what cost.

    python benchmarks/integrity_detection.py --out detection

Simulated drives (profile mixed, grade mems_m without outliers of its own) whose fixes get spikes,
steps, ramps and freezes, filtered with every way of
:data:`navlearn.experiment.integrity_ways.WAYS`. A fix is caught where it is refused or taken with
less than half its weight; a fault where one of its fixes is. The share of good fixes caught is
that of false alarms, after faults included, when a filter may have been led away. Intervals:
Wilson's for faults, bootstrap by drive for the rest. ``--sweep`` varies each limit (receiver
operating curves, over spikes and over steps); ``--limits`` shows what the limits were set by:
``--limits --seeds 11 12 13 14 15 16``.
"""

import argparse
import math
import os
from collections.abc import Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
import pandas as pd
import torch

from navlearn.experiment.gated_run import GatedRun, gated_run
from navlearn.experiment.integrity_ways import GRID, OPEN, WAYS
from navlearn.fusion.gate_options import GateOptions
from navlearn.logs.drive_log import DriveLog
from navlearn.logs.resample import riss_timeline
from navlearn.logs.synthetic import Biases, FaultOptions, Freezes, Ramps, Spikes, simulate_drive
from navlearn.logs.synthetic.faults import injected_faults, with_faults
from navlearn.logs.synthetic.grades import find_grade
from navlearn.outages.detection import share_row
from navlearn.outages.detection_plots import plot_detection, plot_operating_curves
from navlearn.outages.detection_summary import rms_by_drive

SIZES = (2.0, 5.0, 10.0, 20.0, 50.0, 100.0)
STRETCH = {"durations": (30.0,), "per_hour": 60.0}
RAMP = {"sizes": (10.0, 20.0, 50.0, 100.0), "durations": (60.0,), "per_hour": 60.0}
KINDS: dict[str, FaultOptions] = {
    "spike": FaultOptions(spikes=Spikes(sizes=SIZES, per_hour=240.0), apart=15.0),
    "step": FaultOptions(biases=Biases(sizes=(5.0, 10.0, 20.0, 50.0), **STRETCH), apart=60.0),
    "ramp": FaultOptions(ramps=Ramps(**RAMP), apart=60.0),
    "ramp, velocity too": FaultOptions(ramps=Ramps(**RAMP, velocity=True), apart=60.0),
    "freeze": FaultOptions(freezes=Freezes(per_hour=60.0), apart=60.0),
    "none": FaultOptions(),
}
LEAST_FREEZE = 10.0
"""A car that moves less while its receiver is frozen makes no fault, m."""
AFTER = 10.0
SWEPT: dict[str, list[tuple[float, GateOptions]]] = {
    "χ² gate": [(p, GateOptions(probability=p)) for p in (0.5, 0.8, 0.95, 0.99, 0.999, 1 - 1e-6)],
    "prediction limit": [(x, replace(OPEN, prediction_limit=x)) for x in GRID[:9]],
    "motion limit": [(x, replace(OPEN, motion_limit=x)) for x in GRID[:9]],
    "motion limit as printed": [
        (x, replace(OPEN, motion_limit=x, motion_reference="none")) for x in (10, 20, 30, 40, 60)
    ],
    "Huber": [
        (x, replace(OPEN, robust="huber", robust_limit=x)) for x in (0.3, 0.6, 1.0, 1.345, 2)
    ],
    "Student": [(x, replace(OPEN, robust="student", freedom=x)) for x in (0.5, 1.0, 2.0, 4.0, 8.0)],
}


def drive_of(seed: int, seconds: float, grade: str = "mems_m") -> DriveLog:
    """Return a drive whose receiver has no outliers of its own."""
    figures = find_grade(grade)
    quiet = replace(figures, gnss=replace(figures.gnss, spike_probability=0.0))
    return simulate_drive(seed=seed, duration=seconds, imu_rate_hz=10.0, grade=quiet).log


def filtered(log: DriveLog, gate: GateOptions) -> GatedRun:
    """Return what became of every fix, and the position error at every time of the reference."""
    return gated_run(log, riss_timeline(log, rate_hz=10.0, dims=3), gate)


def judged(log: DriveLog, gate: GateOptions) -> tuple[list[dict[str, float]], dict[str, float]]:
    """Return a row per fault, and one of the drive."""
    fixes, errors = filtered(log, gate)
    faults = injected_faults(log)
    t, off = errors["t"].to_numpy(), errors["horizontal"].to_numpy()
    rows = []
    near = np.zeros(t.shape, dtype=bool)
    for fault in [] if faults is None else faults.to_dict("records"):
        mine = fixes.loc[fixes["fault"] == fault["fault"], ["t", "caught"]]
        size = math.hypot(fault["east"], fault["north"])
        during = (t >= fault["t"]) & (t <= fault["t"] + fault["duration"] + AFTER)
        near |= during
        if mine.empty or (fault["kind"] == "freeze" and size < LEAST_FREEZE):
            continue
        first = mine.loc[mine["caught"], "t"].min()
        rows.append(
            {
                "size": round(size) if fault["kind"] != "freeze" else math.nan,
                "caught": bool(mine["caught"].any()),
                "share": float(mine["caught"].mean()),
                "after": float(first - fault["t"]),
                "worst": float(off[during].max()),
            }
        )
    good = fixes[fixes["fault"] == 0]
    drive = {"good": len(good), "alarms": int(good["caught"].sum()), "times": len(t)}
    drive |= {"squares": float((off**2).sum()), "worst": float(off.max())}
    return rows, drive | {"near": int(near.sum()), "near_squares": float((off[near] ** 2).sum())}


def one_drive(
    seed: int, *, seconds: float, kinds: Sequence[str], gates: Mapping[str, GateOptions]
) -> tuple[list[dict[str, object]], list[dict[str, object]]]:
    """Return the rows of faults and drives of one seed."""
    torch.set_num_threads(1)
    clean, faults, drives = drive_of(seed, seconds), [], []
    for kind in kinds:
        log = with_faults(clean, replace(KINDS[kind], seed=seed)).log
        for way, gate in gates.items():
            rows, drive = judged(log, gate)
            about = {"seed": seed, "kind": kind, "way": way}
            faults += [about | row for row in rows]
            drives.append(about | drive)
    return faults, drives


def over_drives(
    asked: argparse.Namespace, kinds: Sequence[str], gates: Mapping[str, GateOptions]
) -> tuple[pd.DataFrame, pd.DataFrame]:
    """Return the rows of all seeds, worked off by so many processes."""
    work = partial(one_drive, seconds=asked.seconds, kinds=kinds, gates=gates)
    with ProcessPoolExecutor(asked.jobs) as pool:
        done = list(pool.map(work, asked.seeds))
    tables = ([row for one in done for row in one[k]] for k in (0, 1))
    return tuple(pd.DataFrame(rows) for rows in tables)  # type: ignore[return-value]


def detection_table(faults: pd.DataFrame) -> pd.DataFrame:
    """Return the share of faults caught, by kind, size and way."""
    rows = []
    for (kind, way, size), part in faults.groupby(
        ["kind", "way", "size"], sort=False, dropna=False
    ):
        row = share_row(kind, part["caught"])
        more = {"fixes_caught": part["share"].mean(), "seconds": part["after"].median()}
        rows.append({"way": way, "size": size, **row, **more, "worst": part["worst"].median()})
    return pd.DataFrame(rows).rename(columns={"fixes": "faults"})


def show(faults: pd.DataFrame, drives: pd.DataFrame) -> pd.DataFrame:
    """Print the tables and return that of detection."""
    found = detection_table(faults)
    for kind, part in found.groupby("kind", sort=False):
        print(f"\n{kind}: faults caught, % (95 % interval); [fixes of them caught, %]")
        part = part.sort_values("size", kind="stable")
        part = part.assign(
            told=[
                f"{100 * s:.0f} ({100 * a:.0f}-{100 * b:.0f}) [{100 * f:.0f}]"
                for s, a, b, f in part[["share", "low", "high", "fixes_caught"]].to_numpy()
            ],
            m=part["size"].map(lambda x: f"{x:.0f} m" if x == x else "all"),
        )
        order = list(dict.fromkeys(part["m"]))
        wide = part.pivot_table(index="way", columns="m", values="told", aggfunc="first")[order]
        print(wide.reindex([w for w in WAYS if w in wide.index]).to_string())
    print("\nfalse alarms, % of good fixes; RMS of position, m: whole drive, and until 10 s after")
    print("faults; its largest, m: median over drives (intervals: bootstrap over drives)")
    rows = [
        {"kind": kind, "way": way, **rms_by_drive(part)}
        for (kind, way), part in drives.groupby(["kind", "way"], sort=False)
    ]
    print(pd.DataFrame(rows).to_string(index=False))
    return found


def sweep(asked: argparse.Namespace) -> pd.DataFrame:
    """Return detection and false alarms over every limit."""
    gates = {f"{way}|{x:g}": g for way, swept in SWEPT.items() for x, g in swept}
    faults, drives = over_drives(asked, ("spike", "step", "none"), gates)
    found = detection_table(faults).rename(columns={"way": "gate"})
    clean = drives[drives["kind"] == "none"].groupby("way")[["alarms", "good"]].sum()
    own = drives.groupby(["kind", "way"])[["alarms", "good", "squares", "times"]].sum()
    at = pd.MultiIndex.from_frame(found[["kind", "gate"]])
    split = found["gate"].str.split("|", expand=True)
    return found.assign(
        way=split[0],
        limit=split[1].astype(float),
        alarms_clean=(clean["alarms"] / clean["good"])[found["gate"]].to_numpy(),
        alarms=(own["alarms"] / own["good"])[at].to_numpy(),
        rms=np.sqrt(own["squares"] / own["times"])[at].to_numpy(),
    )


def limits(asked: argparse.Namespace) -> None:
    """Print false alarms by limit on drives without faults, with and without outages."""
    for seconds in (60.0, 0.0):
        rows: dict[str, np.ndarray] = {}
        for seed in asked.seeds:
            log = drive_of(seed, asked.seconds, asked.grade)
            t = log.fixes["t"]
            kept = log.fixes[(t % 300.0 < 300.0 - seconds) | (t < 300.0)].reset_index(drop=True)
            for way, swept in SWEPT.items():
                for x, gate in swept:
                    fixes = filtered(replace(log, fixes=kept), gate).fixes
                    told = np.array((fixes["caught"].sum(), len(fixes)))
                    rows[f"{way} {x:g}"] = rows.get(f"{way} {x:g}", 0) + told
        print(f"\noutages of {seconds:g} s every 300 s: good fixes caught, of how many, %")
        for name, (caught, count) in rows.items():
            print(f"{name:32s} {caught:6d} {count:6d} {100.0 * caught / count:8.3f}")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.split("\n", 1)[0])
    parser.add_argument("--seeds", type=int, nargs="+", default=list(range(100, 108)))
    parser.add_argument("--seconds", type=float, default=1500.0)
    parser.add_argument("--kinds", nargs="+", choices=list(KINDS), default=list(KINDS))
    parser.add_argument("--ways", nargs="+", choices=list(WAYS), default=list(WAYS))
    parser.add_argument("--sweep", action="store_true", help="vary every limit")
    parser.add_argument("--limits", action="store_true", help="show what limits were set by")
    parser.add_argument("--grade", default="mems_m", help="sensors of --limits")
    parser.add_argument("--jobs", type=int, default=1, help="processes")
    parser.add_argument("--out", type=Path, help="folder for CSV files and figures")
    asked = parser.parse_args()
    os.environ.setdefault("OMP_NUM_THREADS", "1")
    torch.set_num_threads(1)
    if asked.limits:
        limits(asked)
        return
    if asked.out is not None:
        asked.out.mkdir(parents=True, exist_ok=True)
    if asked.sweep:
        found = sweep(asked)
        print(found.drop(columns="gate").to_string(index=False, float_format="%.4f"))
        if asked.out is not None:
            found.to_csv(asked.out / "operating.csv", index=False)
            plot_operating_curves(asked.out / "operating.png", found)
        return
    faults, drives = over_drives(asked, asked.kinds, {way: WAYS[way] for way in asked.ways})
    found = show(faults, drives)
    if asked.out is not None:
        for name, table in (("faults", faults), ("drives", drives), ("detection", found)):
            table.to_csv(asked.out / f"{name}.csv", index=False)
        plot_detection(asked.out / "detection.png", found)


if __name__ == "__main__":
    main()
