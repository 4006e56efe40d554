"""ANARX predictor: microseconds per step and per window row, eager against TorchScript.

    python benchmarks/predictor.py

Untrained weights: time does not depend on them. One thread, best of some repeats; the ratio is
to eager in the same run. The difference is the largest between TorchScript and eager, stepping
through the whole record.
"""

import argparse
import json
import time
from collections.abc import Callable
from typing import Any

import torch
from torch import Tensor

from navlearn.error_models.anarx import Anarx, AnarxOptions
from navlearn.export.predictor import Predictor
from navlearn.export.quiet import without_retirement_notice


def build(lags: int, hidden: int) -> tuple[Predictor, Any]:
    torch.manual_seed(0)
    model = Anarx(AnarxOptions(inputs=3, outputs=2, lags=lags, hidden=hidden))
    with torch.no_grad():
        for weights in model.parameters():
            torch.nn.init.normal_(weights, std=0.2)
    about = {"inputs": ["yaw_rate", "speed", "delay"]}
    eager = Predictor(model, json.dumps(about)).eval()
    with without_retirement_notice():
        return eager, torch.jit.script(eager)


def stream(predictor: Any, rows: list[Tensor]) -> Tensor:
    state = predictor.initial_state(rows[0])
    corrections = []
    for row in rows:
        y, state = predictor.step(row, state)
        corrections.append(y)
    return torch.stack(corrections)


def best(work: Callable[[], object], repeats: int) -> float:
    times = []
    for _ in range(repeats):
        begin = time.perf_counter()
        work()
        times.append(time.perf_counter() - begin)
    return min(times)


@torch.no_grad()
def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--rows", type=int, default=600)
    parser.add_argument("--lags", type=int, default=2)
    parser.add_argument("--hidden", type=int, default=5)
    parser.add_argument("--repeats", type=int, default=20)
    chosen = parser.parse_args()
    torch.set_num_threads(1)
    eager, scripted = build(chosen.lags, chosen.hidden)
    u = torch.randn(chosen.rows, 3, dtype=torch.float64)
    rows = list(u)
    print(f"{'':12}{'µs per step':>14}{'ratio':>8}{'µs per window row':>20}{'ratio':>8}")
    base: tuple[float, float] | None = None
    for name, predictor in (("eager", eager), ("TorchScript", scripted)):
        stream(predictor, rows)
        predictor(u)
        step = 1e6 * best(lambda p=predictor: stream(p, rows), chosen.repeats) / chosen.rows
        window = 1e6 * best(lambda p=predictor: p(u), chosen.repeats) / chosen.rows
        base = base or (step, window)
        ratios = base[0] / step, base[1] / window
        print(f"{name:12}{step:14.1f}{ratios[0]:8.2f}{window:20.2f}{ratios[1]:8.2f}")
    difference = (stream(scripted, rows) - stream(eager, rows)).abs().max()
    print(f"largest difference of a step: {float(difference):.2g}")


if __name__ == "__main__":
    main()
