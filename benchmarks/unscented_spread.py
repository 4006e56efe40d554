"""How widely sigma points should be spread: simulated drives that start with a wrong azimuth.

    python benchmarks/unscented_spread.py                        # five minutes
    python benchmarks/unscented_spread.py --seeds 11 --draws 4   # quick

Drives of grade mems_m start where the car moves, from the truth but for an azimuth drawn with the
deviation that the filter is told; the gate is off. Per deviation and filter: position RMSE over
the first 60 s, azimuth RMSE after 10 and 60 s, the share of runs that are more than 10° off after
60 s, and mean and median of the NEES of east, north and azimuth over the first 20 s, of which 3
and 2.4 are honest; the drives' own hills and odometer make 12 of the mean.
"""

import argparse
import math
import warnings
from typing import Any

import numpy as np
import torch
from torch import Tensor

from navlearn.attitude import wrap_angle
from navlearn.filters.consistency import nees
from navlearn.filters.unscented import UnscentedOptions
from navlearn.fusion.error_state import initial_belief, position_difference
from navlearn.fusion.filters_of import riss_filter
from navlearn.fusion.gate_options import GateOptions
from navlearn.fusion.noise_options import InitialOptions
from navlearn.fusion.options import EkfOptions
from navlearn.logs.resample import riss_timeline
from navlearn.logs.synthetic import simulate_drive
from navlearn.mechanization.options import RissOptions
from navlearn.states import FixTiming, GnssFix, NavState, RissSample

RATE, LENGTH = 10, 60

SPREADS = {
    "extended": None,
    "γ √3": UnscentedOptions(alpha=None),
    "α 1": UnscentedOptions(alpha=1.0),
    "α 0.1": UnscentedOptions(alpha=0.1),
    "α 1e-3": UnscentedOptions(alpha=1e-3),
    "γ √3, β 0": UnscentedOptions(alpha=None, beta=0.0),
    "α 1, κ 3": UnscentedOptions(alpha=1.0, kappa=3.0),
}


def drive(seed: int) -> tuple[NavState, NavState, RissSample, GnssFix, FixTiming]:
    """Return truth at the start and after each sample, and a minute of samples and fixes."""
    log = simulate_drive(
        profile="mixed", grade="mems_m", duration=300.0, seed=seed, imu_rate_hz=RATE
    ).log
    line = riss_timeline(log, rate_hz=RATE, dims=2)
    first = int(torch.nonzero((line.samples.speed > 8.0) & (line.t > line.t[0] + 20.0))[0])
    part = slice(first, first + RATE * LENGTH)
    table = log.reference
    assert table is not None
    at = line.t[first - 1 : first + RATE * LENGTH].numpy()
    columns = [table[name].to_numpy() for name in ("lat", "lon", "height")]
    columns.append(np.unwrap(table["azimuth"].to_numpy()))
    truth = NavState(*(torch.from_numpy(np.interp(at, table["t"], x)) for x in columns))
    used = (line.timing.index >= first) & (line.timing.index < part.stop)
    timing = FixTiming(line.timing.index[used] - first, line.timing.delay[used])
    return (
        NavState(*(x[:1] for x in truth)),
        NavState(*(x[1:] for x in truth)),
        RissSample(*(x[part] for x in line.samples)),
        GnssFix(*(x[used] for x in line.fixes)),
        timing,
    )


def options_of(sigma: float, points: UnscentedOptions | None) -> EkfOptions:
    """Return the choices of a filter that starts with a deviation of azimuth."""
    return EkfOptions(
        gate=GateOptions(probability=1.0),
        initial=InitialOptions(azimuth=sigma),
        mechanization=RissOptions(dimensions=2),
        unscented=points,
    )


def errors(seed: int, draws: int, sigma: float, points: UnscentedOptions | None) -> list[Tensor]:
    """Return position error, azimuth error and NEES, shape (draws, T or K) each."""
    start, truth, samples, fixes, timing = drive(seed)
    options = options_of(sigma, points)
    g = torch.Generator().manual_seed(1000 + seed)
    wrong = sigma * torch.randn(draws, generator=g, dtype=torch.float64)

    def batched(tree: Any) -> Any:
        return type(tree)(*(x.expand(draws, *x.shape) for x in tree))

    begin = NavState(*(x.expand(draws) for x in start))
    begin = begin._replace(azimuth=begin.azimuth + wrong)
    with torch.no_grad():
        found = riss_filter(options)(
            initial_belief(options, begin), batched(samples), batched(fixes), batched(timing)
        )
    path = NavState(*found.trajectory[:4])
    place = position_difference(path, batched(truth))[..., :2]
    turn = wrap_angle(path.azimuth - truth.azimuth)
    seen = torch.cat((place, turn.unsqueeze(-1)), -1)
    end = found.end.unsqueeze(-1).expand(*found.end.shape, 3)
    P = found.belief.covariance[..., [0, 1, 3], :][..., [0, 1, 3]]
    return [place.norm(dim=-1), turn, nees(torch.gather(seen, 1, end), P)]


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seeds", type=int, nargs="+", default=[11, 12, 13, 14, 15, 16])
    parser.add_argument("--draws", type=int, default=12)
    parser.add_argument("--degrees", type=float, nargs="+", default=[20.0, 60.0, 90.0])
    parser.add_argument("--filters", nargs="+", choices=tuple(SPREADS))
    given = parser.parse_args()
    torch.set_num_threads(1)
    warnings.simplefilter("ignore")  # what is wrong is what the table is about
    for degrees in given.degrees:
        print(f"\nazimuth at the start ± {degrees:g}°")
        print(
            f"{'filter':10} {'RMSE m':>8} {'10 s °':>8} {'60 s °':>8} "
            f"{'lost':>6} {'NEES':>8} {'half':>6}"
        )
        for name, points in SPREADS.items():
            if given.filters and name not in given.filters:
                continue
            runs = [errors(s, given.draws, math.radians(degrees), points) for s in given.seeds]
            place, turn, squares = (torch.cat(x) for x in zip(*runs, strict=True))
            after = [turn[:, k * RATE - 1] for k in (10, 60)]
            rms = [math.degrees(float(x.square().mean().sqrt())) for x in after]
            lost = float((after[1].abs() > math.radians(10.0)).double().mean())
            print(
                f"{name:10} {float(place.square().mean().sqrt()):8.2f} {rms[0]:8.2f} "
                f"{rms[1]:8.2f} {lost:6.0%} {float(squares[:, :20].mean()):8.2f} "
                f"{float(squares[:, :20].median()):6.2f}"
            )


if __name__ == "__main__":
    main()
