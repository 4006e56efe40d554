"""Predictors: microseconds per step and per window row, eager against TorchScript.

    python benchmarks/predictor.py

ANARX, a FOS polynomial of eight terms, PCI of three cascades with eleven lags; three inputs.
Weights are not trained: time does not depend on them. One thread, best of some repeats; the ratio
is to eager in the same run. The difference is the largest between TorchScript and eager, stepping
through the whole record.
"""

import argparse
import json
import time
from collections.abc import Callable
from typing import Any

import torch
from torch import Tensor, nn

from navlearn.error_models.anarx import Anarx, AnarxOptions
from navlearn.error_models.fos import FosModel
from navlearn.error_models.fos_options import FosOptions
from navlearn.error_models.pci import PciModel, PciOptions
from navlearn.error_models.pci_candidates import Cascades
from navlearn.export.predictor import Predictor
from navlearn.export.quiet import without_retirement_notice


def anarx(lags: int, hidden: int) -> nn.Module:
    model = Anarx(AnarxOptions(inputs=3, outputs=2, lags=lags, hidden=hidden))
    with torch.no_grad():
        for weights in model.parameters():
            torch.nn.init.normal_(weights, std=0.2)
    return model


def fos() -> nn.Module:
    pairs = [((0, 0),), ((1, 0),), ((2, 1),), ((0, 0), (0, 0)), ((0, 0), (1, 0)), ((1, 1), (2, 0))]
    model = FosModel(3, ((), *pairs, ((0, 1), (0, 1))), FosOptions(safeguard=False))
    with torch.no_grad():
        model.coefficients.normal_(std=0.2)
    return model


def pci() -> nn.Module:
    model = PciModel(PciOptions(inputs=3))
    one, wide = torch.ones(3, 3).double(), torch.full((3,), torch.inf).double()
    weight = torch.randn(3, 4).double()
    model.set_cascades(Cascades(0.2 * torch.randn(3, 33).double(), one, one, weight, -wide, wide))
    return model


def both(model: nn.Module) -> tuple[Predictor, Any]:
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
    torch.manual_seed(0)
    u = torch.randn(chosen.rows, 3, dtype=torch.float64)
    print(f"{'':18}{'µs per step':>14}{'ratio':>8}{'µs per window row':>20}{'ratio':>8}")
    models = {"anarx": anarx(chosen.lags, chosen.hidden), "fos": fos(), "pci": pci()}
    for kind, model in models.items():
        eager, scripted = both(model)
        time_both(kind, {"eager": eager, "TorchScript": scripted}, u, chosen.repeats)
        difference = (stream(scripted, list(u)) - stream(eager, list(u))).abs().max()
        print(f"{kind}: largest difference of a step {float(difference):.2g}")


def time_both(kind: str, predictors: dict[str, Any], u: Tensor, repeats: int) -> None:
    rows = list(u)
    base: tuple[float, float] | None = None
    for name, predictor in predictors.items():
        stream(predictor, rows)
        predictor(u)
        step = 1e6 * best(lambda p=predictor: stream(p, rows), repeats) / len(rows)
        window = 1e6 * best(lambda p=predictor: p(u), repeats) / len(rows)
        base = base or (step, window)
        ratios = base[0] / step, base[1] / window
        print(f"{kind + ' ' + name:18}{step:14.1f}{ratios[0]:8.2f}{window:20.2f}{ratios[1]:8.2f}")


if __name__ == "__main__":
    main()
