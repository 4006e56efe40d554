"""Speed of the unscented filters of RISS and full IMU, loose and tight, beside the extended ones.

    python benchmarks/ukf_vehicles.py                  # ten minutes at 100 Hz
    python benchmarks/ukf_vehicles.py --minutes 2      # quick

A simulated drive (mixed roads, MEMS IMU, a fix and ten satellites per second), aligned by the
navigator as for the tight filter's benchmark. CPU seconds of one thread, best of some repeats;
``x ekf`` is the same form of the extended filter over the same work, ``x exact`` the loop over
blocks of the same filter: above one is faster. The loops run forward and backward over a shorter
stretch, too. Differences are the largest of the positions at full rate from those of the extended
filter.
"""

import argparse
import time
from dataclasses import replace
from typing import Any

import torch
from tight_ekf import RATE, VEHICLES, Work, drive, shortened
from torch import Tensor

from navlearn.filters.unscented import UnscentedOptions
from navlearn.frames import enu_between
from navlearn.fusion.filters_of import ins_filter, riss_filter
from navlearn.fusion.options import EkfOptions
from navlearn.fusion.tight.ins_vehicle import InsVehicle
from navlearn.fusion.tight.module import TightEkf
from navlearn.fusion.tight.riss_vehicle import RissVehicle


def filters(kind: str, systems: int, unscented: UnscentedOptions | None) -> dict[str, Any]:
    """Return the loosely and the tightly coupled filter of a kind of car."""
    options: Any = replace(VEHICLES[kind], unscented=unscented)  # type: ignore[type-var]
    riss = isinstance(options, EkfOptions)
    vehicle: Any = RissVehicle(options) if riss else InsVehicle(options)
    loose: Any = riss_filter(options) if riss else ins_filter(options)
    return {"loose": loose, "tight": TightEkf(vehicle, systems=systems)}


def spent(ekf: Any, work: Work, method: str, backward: bool, repeats: int) -> tuple[float, Any]:
    """Return CPU seconds of the best run, and its history."""
    best, history = float("inf"), None
    for _ in range(repeats):
        ekf.zero_grad(set_to_none=True)
        ekf.log_noise.requires_grad_(backward)
        begin = time.process_time()
        with torch.set_grad_enabled(backward):
            if isinstance(ekf, TightEkf):
                given: tuple[Any, ...] = (work.start, work.samples, work.ranges, work.timing)
            else:
                given = (work.start.vehicle, work.samples, work.fixes, work.timing)
            history = ekf(*given, method=method)
            if backward:
                loss: Tensor = history.nis.nansum()
                loss.backward()
        best = min(best, time.process_time() - begin)
    return best, history


def apart(one: Any, other: Any) -> float:
    way = enu_between(*one.trajectory[:3], *other.trajectory[:3])
    return float(torch.stack(way).detach().norm(dim=0).max())


def print_kind(kind: str, options: argparse.Namespace) -> None:
    found, work = drive(60 * options.minutes, kind)
    systems = found.tight.model.systems
    points = UnscentedOptions(alpha=options.alpha)
    linear, unscented = filters(kind, systems, None), filters(kind, systems, points)
    few = min(options.short, 60 * options.minutes)
    jobs = [("exact", False), ("fast", False), ("exact", True), ("fast", True)]
    for coupling in ("loose", "tight"):
        base: dict[bool, float] = {}
        for method, backward in jobs:
            piece = shortened(work, few) if backward else work
            seconds = piece.samples.dt.shape[-1] / RATE
            own, history = spent(unscented[coupling], piece, method, backward, options.repeats)
            ekf, other = spent(linear[coupling], piece, method, backward, options.repeats)
            exact = base.setdefault(backward, own)
            label = f"{kind} {coupling}"
            form = method + (" forward+backward" if backward else " forward")
            rate = seconds * RATE / own
            note = f"{seconds:.0f} s, {history.method}, {history.passes} passes"
            print(
                f"{label:12} {form:22} {own:8.3f} {rate:11.0f} {ekf / own:7.3f} {exact / own:8.2f}"
                f"  {note}, {apart(history, other):.2g} m from the extended filter",
                flush=True,
            )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--minutes", type=int, default=10)
    parser.add_argument("--short", type=int, default=60, help="seconds of runs with gradients")
    parser.add_argument(
        "--alpha", type=float, help="spread of the points; √3 deviations if not given"
    )
    parser.add_argument("--vehicles", nargs="+", default=list(VEHICLES), choices=list(VEHICLES))
    parser.add_argument("--repeats", type=int, default=3)
    options = parser.parse_args()
    torch.set_num_threads(1)
    print(f"{'filter':12} {'form':22} {'CPU s':>8} {'samples/s':>11} {'x ekf':>7} {'x exact':>8} ")
    for kind in options.vehicles:
        print_kind(kind, options)


if __name__ == "__main__":
    main()
