"""What simulated skies give, and what positions from their ranges are worth.

    python benchmarks/simulated_skies.py

Three tables, over seeds 11 to 13, at 44° north: what the presets give with GPS alone (the page of
simulated satellites); horizontal and vertical 95 % errors of positions, m, by how ranges are
tested and weighed (drives of 15 minutes); and how often fixes lie beyond the deviations that they
state, with the loosely coupled filter that is told them (drives of 40 and 30 minutes), without
and with the factor that residuals put on deviations.
"""

import argparse
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pandas as pd
import torch

from navlearn.gnss.dilution import dilution
from navlearn.gnss.sight import sight
from navlearn.gnss.single_point_options import SinglePointOptions
from navlearn.logs.drive_log import DriveLog
from navlearn.logs.quality.accuracy import errors_against
from navlearn.logs.resample import riss_timeline
from navlearn.logs.single_point_fixes import (
    ReceptionSolutions,
    SinglePointFixOptions,
    fixes_of,
    solve_receptions,
)
from navlearn.logs.synthetic import PRESETS, SimulatedDrive, simulate_drive
from navlearn.navigator import Navigator

Array = np.ndarray
EVERYTHING = (("suburban", "G"), ("suburban", "GRE"), ("urban", "G"), ("urban", "GR"))
EVERYTHING += (("urban", "GRE"),)
WAYS = {
    "least squares": SinglePointOptions(probability=1.0, huber=np.inf),
    "tested": SinglePointOptions(huber=np.inf),
    "Huber alone": SinglePointOptions(probability=1.0),
    "tested, Huber": SinglePointOptions(),
}
CHI_95, CHI_999 = 2.448, 3.717
"""Deviations beyond which one normal error of two axes in 20, or in 1000, lies."""


def drive_in(sky: str, systems: str, seed: int, seconds: float) -> SimulatedDrive:
    options = replace(PRESETS[sky], systems=tuple(systems), fixes="drawn")
    return simulate_drive(duration=seconds, seed=seed, imu_rate_hz=10.0, satellites=options)


def horizontal(fixes: pd.DataFrame, log: DriveLog) -> tuple[Array, Array]:
    """Return errors east and north, m."""
    _, east, north, _ = errors_against(fixes, log.reference)
    return east, north


def figures_of(drive: SimulatedDrive) -> dict[str, float]:
    """Return what a drive's sky gave."""
    found, truth = solve_receptions(drive.log), drive.range_truth.table
    ranges, points = found.series.ranges, found.points
    heard = ranges.has_range.sum(-1)
    unit = sight(points.lat, points.lon, points.height, ranges.satellite).unit
    hdop = dilution(unit, ranges.has_range).hdop[points.ok]
    off = np.hypot(*horizontal(fixes_of(found), drive.log))
    error = truth["range_error"].to_numpy()
    median, most = np.quantile(np.abs(error), (0.5, 0.95))
    return {
        "satellites received, mean": float(heard.mean()),
        "fewest": float(heard.min()),
        "receptions of fewer than four, %": 100.0 * float((heard < 4).double().mean()),
        "ranges by reflection alone, %": 100.0 * float((truth["reflection"] > 0.0).mean()),
        "error of ranges, RMS, m": float(np.sqrt(np.mean(error**2))),
        "median": float(median),
        "95 %": float(most),
        "error of range rates, RMS, m/s": float(np.sqrt((truth["rate_error"] ** 2).mean())),
        "horizontal dilution, median": float(hdop.median()),
        "horizontal dilution, 95 %": float(torch.quantile(hdop, 0.95)),
        "receptions that give a fix, %": 100.0 * float(points.ok.double().mean()),
        "error of fixes, median, m": float(np.nanquantile(off, 0.5)),
        "error of fixes, 95 %": float(np.nanquantile(off, 0.95)),
        "error of fixes, RMS": float(np.sqrt(np.nanmean(off**2))),
        "largest": float(np.nanmax(off)),
    }


def show_presets(seeds: Sequence[int], seconds: float) -> None:
    skies = ("open_sky", "suburban", "urban")
    table = {}
    for sky in skies:
        drives = [figures_of(drive_in(sky, "G", seed, seconds)) for seed in seeds]
        extreme = {"fewest": min, "largest": max}
        table[sky] = {
            name: extreme.get(name, np.mean)([drive[name] for drive in drives])
            for name in drives[0]
        }
    print(f"{'':34}" + "".join(f"{sky:>10}" for sky in skies))
    for name in table["urban"]:
        print(f"{name:34}" + "".join(f"{table[sky][name]:10.2f}" for sky in skies))


def show_ways(seeds: Sequence[int], seconds: float) -> None:
    print(f"\n{'':16}" + "".join(f"{way:>16}" for way in WAYS))
    for sky, systems in EVERYTHING:
        cells = {way: ([], []) for way in WAYS}
        for seed in seeds:
            log = drive_in(sky, systems, seed, seconds).log
            for way, options in WAYS.items():
                found = solve_receptions(log, SinglePointFixOptions(single_point=options))
                _, east, north, up = errors_against(fixes_of(found), log.reference)
                for cell, error in zip(
                    cells[way], (np.hypot(east, north), np.abs(up)), strict=True
                ):
                    cell.append(error[np.isfinite(error)])
        told = (
            " / ".join(f"{np.quantile(np.concatenate(part), 0.95):.1f}" for part in cells[way])
            for way in WAYS
        )
        print(f"{sky + ', ' + systems:16}" + "".join(f"{text:>16}" for text in told))


def without_factor(found: ReceptionSolutions) -> pd.DataFrame:
    """Return fixes whose deviations follow from the stated noise alone."""
    fixes, kept = fixes_of(found), found.points.ok
    level = found.velocities.covariance.diagonal(dim1=-2, dim2=-1)[:, :2].mean(-1).sqrt()
    spread = found.points.covariance.diagonal(dim1=-2, dim2=-1).sqrt()[kept].numpy()
    own = dict(zip(("std_e", "std_n", "std_u"), spread.T, strict=True))
    return fixes.assign(
        **own, std_v=level[kept].where(found.velocities.ok[kept], torch.nan).numpy()
    )


def filtered(log: DriveLog, fixes: pd.DataFrame) -> float:
    """Return the RMS horizontal error of the loosely coupled filter, m."""
    line = riss_timeline(log.with_tables({"fixes": fixes}), rate_hz=10.0, dims=3)
    run = Navigator().run(line.samples, line.fixes, line.timing)
    path = run.history.trajectory
    columns = {"lat": path.lat, "lon": path.lon, "height": path.height}
    table = {name: column.numpy() for name, column in columns.items()}
    east, north = horizontal(pd.DataFrame({"t": line.t[run.first :].numpy(), **table}), log)
    return float(np.sqrt(np.nanmean(east**2 + north**2)))


def show_deviations(seeds: Sequence[int], seconds: float) -> None:
    print(f"\n{'beyond':16}{'95 %':>18}{'99.9 %':>18}{'RMS of filter, m':>20}")
    for sky, systems in EVERYTHING:
        off, rms = ([], []), ([], [])
        for seed in seeds:
            log = drive_in(sky, systems, seed, seconds).log
            found = solve_receptions(log)
            short = drive_in(sky, systems, seed, 0.75 * seconds).log
            solved = solve_receptions(short)
            for k, make in enumerate((without_factor, fixes_of)):
                fixes = make(found)
                east, north = horizontal(fixes, log)
                off[k].append(np.hypot(east / fixes["std_e"], north / fixes["std_n"]))
                rms[k].append(filtered(short, make(solved)))
        told = [
            " -> ".join(f"{100.0 * np.mean(np.concatenate(part) > limit):.1f} %" for part in off)
            for limit in (CHI_95, CHI_999)
        ]
        told.append(" -> ".join(f"{np.mean(part):.2f}" for part in rms))
        print(f"{sky + ', ' + systems:16}{told[0]:>18}{told[1]:>18}{told[2]:>20}")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--seeds", type=int, nargs="+", default=(11, 12, 13))
    parser.add_argument("--seconds", type=float, default=2400.0, help="length of a drive")
    wanted = parser.parse_args()
    torch.set_num_threads(1)
    show_presets(wanted.seeds, wanted.seconds)
    show_ways(wanted.seeds, 0.375 * wanted.seconds)
    show_deviations(wanted.seeds, wanted.seconds)


if __name__ == "__main__":
    main()
