"""Positions over a whole drive, no outage made: the receiver's, from ranges alone, and filtered.

    python training/whole_drive.py training/iqbal2020_pci_pseudorange.yaml

Prints, for open sky and canyons apart, how far each solution is from the reference; what a canyon
is depends on how many satellites were received, never on errors. Filters are those of the recipe.
"""

import argparse
from pathlib import Path

import pandas as pd
import torch

from navlearn.experiment.drive import open_log, set_clocks
from navlearn.experiment.range_fixes import with_fixes
from navlearn.experiment.whole_drive import summary, whole_drive
from navlearn.recipe import Recipe, load_recipe
from navlearn.recipe.sweep import is_sweep, load_sweep
from navlearn.recipe.swept_drives import RecordedDrives


def drives_of(path: Path) -> list[Recipe]:
    """Return one recipe per drive of a recipe, or of a sweep over recorded drives.

    Args:
        path: The recipe's file.
    """
    if not is_sweep(path):
        return [load_recipe(path)]
    sweep = load_sweep(path)
    if not isinstance(sweep.sweep, RecordedDrives):
        raise SystemExit(f"{path}: its drives are simulated; give a recipe of recorded drives")
    logs = [sweep.sweep.source(number) for number in sweep.sweep.seeds]
    one = sweep.for_drive(sweep.name, sweep.sweep.durations_s[0], sweep.sweep.grades[0])
    return [one.model_copy(update={"log": log}) for log in logs]


def main() -> None:
    """Judge every solution of every drive and print the table."""
    parser = argparse.ArgumentParser(description="Positions over whole drives with raw ranges.")
    parser.add_argument("recipes", type=Path, nargs="+")
    parser.add_argument("--clocks-until", type=float, default=900.0, metavar="SECONDS")
    parser.add_argument("--csv", type=Path, help="file for the errors at every time")
    asked = parser.parse_args()
    torch.set_num_threads(1)
    rows = []
    for path in asked.recipes:
        for recipe in drives_of(path):
            log, notes = set_clocks(
                with_fixes(open_log(recipe), recipe), recipe, asked.clocks_until
            )
            errors = whole_drive(log, recipe)
            print(f"{log.metadata.name}: " + "; ".join(notes))
            print(summary(errors).to_string(index=False, float_format="{:.2f}".format), "\n")
            rows.append(errors.assign(drive=log.metadata.name))
    if asked.csv:
        pd.concat(rows).to_csv(asked.csv, index=False)


if __name__ == "__main__":
    main()
