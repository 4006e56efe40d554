"""What a drive's worst fixes do to the filter, behind every way to test fixes.

    python training/worst_fixes.py training/kingston_riss.yaml

The worst fixes are told by the reference, for judging alone. Limits are those of
navlearn.experiment.integrity_ways, set on simulated drives; the filter is the recipe's. With
--chosen-since fixes before a time are not asked for, such as those of a parked car.
"""

import argparse
from pathlib import Path

import torch

from navlearn.experiment.drive import open_log, set_clocks
from navlearn.experiment.integrity_ways import WAYS
from navlearn.experiment.worst_fixes import (
    drive_figures,
    gated_runs,
    through_worst,
    worst_fixes,
)
from navlearn.recipe import load_recipe


def main() -> None:
    """Print the worst fixes with what each way made of them, and the whole drive."""
    parser = argparse.ArgumentParser(description="What a drive's worst fixes do to the filter.")
    parser.add_argument("recipe", type=Path)
    parser.add_argument("--count", type=int, default=10, help="worst fixes")
    parser.add_argument("--clocks-until", type=float, default=900.0, metavar="SECONDS")
    parser.add_argument("--chosen-since", type=float, default=600.0, metavar="SECONDS")
    parser.add_argument("--csv", type=Path, help="file for every worst fix and way")
    asked = parser.parse_args()
    torch.set_num_threads(1)
    recipe = load_recipe(asked.recipe)
    log, notes = set_clocks(open_log(recipe), recipe, asked.clocks_until)
    worst = worst_fixes(log, asked.count, since=asked.chosen_since)
    runs = gated_runs(log, recipe, WAYS)
    found = through_worst(worst, runs)
    print(f"{log.metadata.name}: " + "; ".join(notes))
    print("\nlargest horizontal error of the filter, m, from each fix until 10 s after (* caught)")
    told = found["largest"].map("{:.1f}".format) + found["caught"].map({True: "*", False: ""})
    wide = found.assign(told=told).pivot_table(
        index=["t", "fix_error", "stated"], columns="way", values="told", aggfunc="first"
    )
    print(wide[list(WAYS)].reset_index().to_string(index=False, float_format="{:.1f}".format))
    print("\nhorizontal error, m: from worst fixes until 10 s after (near), and the whole drive")
    print(drive_figures(worst, runs).to_string(index=False, float_format="{:.2f}".format))
    if asked.csv:
        found.to_csv(asked.csv, index=False)


if __name__ == "__main__":
    main()
