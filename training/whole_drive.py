"""Positions over a whole drive, no outage made: the receiver's, from ranges alone, and filtered.

    python training/whole_drive.py training/iqbal2020_pci_pseudorange.yaml

Prints how far each solution is from the reference, canyons apart; what a canyon is depends on how
many satellites were received, never on errors. Filters are those of the recipe.
"""

import argparse
from pathlib import Path

import pandas as pd
import torch

from navlearn.experiment.drive import open_log, set_clocks
from navlearn.experiment.whole_drive import recorded_drives, summary, whole_drive


def main() -> None:
    """Judge every solution of every drive and print the table."""
    parser = argparse.ArgumentParser(description="Positions over whole drives with raw ranges.")
    parser.add_argument("recipes", type=Path, nargs="+")
    parser.add_argument("--log", type=Path, help="descriptor of another log, in place of theirs")
    parser.add_argument("--clocks-until", type=float, default=900.0, metavar="SECONDS")
    parser.add_argument("--csv", type=Path, help="file for the errors at every time")
    asked = parser.parse_args()
    torch.set_num_threads(1)
    rows = []
    for path in asked.recipes:
        for recipe in recorded_drives(path, asked.log):
            log, notes = set_clocks(open_log(recipe), recipe, asked.clocks_until)
            errors = whole_drive(log, recipe)
            print(f"{log.metadata.name}: " + "; ".join(notes))
            print(summary(errors).to_string(index=False, float_format="{:.2f}".format), "\n")
            rows.append(errors.assign(drive=log.metadata.name))
    if asked.csv:
        pd.concat(rows).to_csv(asked.csv, index=False)


if __name__ == "__main__":
    main()
