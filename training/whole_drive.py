"""Errors over whole drives, no outage made.

    python training/whole_drive.py training/iqbal2020_pci_pseudorange.yaml
    python training/whole_drive.py --states training/ghouneem2024_ukf.yaml

Prints how far each solution is from the reference: the receiver's, from ranges alone, and
filtered, canyons apart; what a canyon is depends on how many satellites were received, never on
errors. With --states the recipe's filters side by side, state by state as [Ghouneem2024] Tables II
and III. Filters are those of the recipe.
"""

import argparse
from pathlib import Path

import pandas as pd
import torch

from navlearn.experiment.drive import open_log, set_clocks
from navlearn.experiment.state_rmse import SETTLE, drive_errors, drives_of
from navlearn.experiment.whole_drive import recorded_drives, summary, whole_drive
from navlearn.outages.published import published_section
from navlearn.outages.state_tables import state_report


def main() -> None:
    """Judge every solution of every drive and print the tables."""
    parser = argparse.ArgumentParser(description="Errors over whole drives.")
    parser.add_argument("recipes", type=Path, nargs="+")
    parser.add_argument("--states", action="store_true", help="RMS error of every state")
    parser.add_argument("--drives", type=int, help="with --states: so many drives of each grade")
    parser.add_argument("--first-seed", type=int, help="with --states: in place of the sweep's")
    parser.add_argument("--log", type=Path, help="descriptor of another log, in place of theirs")
    parser.add_argument("--clocks-until", type=float, default=900.0, metavar="SECONDS")
    parser.add_argument("--csv", type=Path, help="file for the errors at every time")
    asked = parser.parse_args()
    torch.set_num_threads(1)
    rows = []
    for path in asked.recipes:
        if asked.states:
            found = [*drives_of(path, asked.clocks_until, asked.drives, asked.first_seed)]
            parts = [drive_errors(one.log, one.recipe).assign(group=one.group) for one in found]
            rows.append(pd.concat(parts))
            for group, errors in rows[-1].groupby("group"):
                print(f"{group}, from {SETTLE:g} s after alignment:")
                print(state_report(errors, found[0].recipe.baselines[0]))
            print("\n".join(published_section([p.table() for p in found[0].recipe.published])))
            continue
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
