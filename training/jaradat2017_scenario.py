"""The networks of [Jaradat2017] on that paper's simulated scenario, draw after draw.

    python training/jaradat2017_scenario.py --seeds 11 12 13

Prints mean and RMS per Earth-fixed axis: of the training residual, of the path in use at every IMU
step, and at missed fixes; INS alone, the last fix held, and the full-IMU filter beside. No gate
keeps a network out here, so the gated twin of the paper's is left out.
"""

import argparse

import pandas as pd
import torch

from navlearn.experiment.jaradat2017_scenario import compare_on_scenario
from navlearn.outages.fit_diagnostics import PREDECESSOR
from navlearn.recipe.ins_anarx_spec import InsAnarxSpec
from navlearn.recipe.spec import BUILT_IN


def main() -> None:
    """Run the draws and print their table."""
    parser = argparse.ArgumentParser(
        description="The networks of [Jaradat2017] on its own scenario."
    )
    parser.add_argument("--seeds", type=int, nargs="+", default=[11, 12, 13])
    parser.add_argument("--csv", help="file for the rows of every draw")
    asked = parser.parse_args()
    torch.set_num_threads(1)
    specs = [spec for spec in BUILT_IN.values() if isinstance(spec, InsAnarxSpec)]
    specs = [spec for spec in specs if spec.mode == "sound" or not spec.safeguard.gate]
    table = pd.concat([compare_on_scenario(seed, specs) for seed in asked.seeds])
    if asked.csv:
        table.to_csv(asked.csv, index=False)
    shown = table.groupby(["measure", "method", "axis"], sort=False)
    figures = pd.DataFrame(
        {
            "mean": shown["mean"].mean(),
            "largest |mean|": shown["mean"].agg(lambda column: column.abs().max()),
            "RMS": shown["rms"].agg(lambda column: (column**2).mean() ** 0.5),
        }
    )
    print(f"{len(asked.seeds)} draws, seeds {asked.seeds}; m\n")
    wide = figures.reset_index().pivot_table(
        index=["measure", "method"], columns="axis", values=list(figures), sort=False
    )
    print(wide.to_string(float_format="{:.3g}".format))
    told = ", ".join(f"{axis} {value:.2e}" for axis, value in PREDECESSOR.items())
    print(f"\n[Jaradat2017] prints means alone, of another drive: {told} m for its predecessor,")
    print("3.73e-06, 4.83e-06 and 2.31e-06 m for itself, on rows that it was trained on.")


if __name__ == "__main__":
    main()
