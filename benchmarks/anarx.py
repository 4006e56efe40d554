"""ANARX: a Levenberg–Marquardt iteration against SciPy's, closed-loop training, one step.

Times are CPU seconds of one thread, so that neighbours' load does not count; what is compared
runs in one process. Command:

    python benchmarks/anarx.py [--samples 10000] [--hidden 10] [--iterations 150]
"""

import argparse
import math
import time
import warnings

import torch
from scipy.optimize import least_squares

from navlearn.error_models.anarx import Anarx, AnarxOptions
from navlearn.error_models.anarx_core import one_step_ahead
from navlearn.error_models.anarx_jacobian import one_step_jacobian, unpack_weights
from navlearn.error_models.scaling import fit_scaling
from navlearn.learning.anarx_least_squares import AnarxLeastSquares
from navlearn.learning.fit import fit_anarx
from navlearn.learning.initialise import random_start
from navlearn.learning.levenberg_marquardt import LmOptions, levenberg_marquardt
from navlearn.learning.lm_training import best_start
from navlearn.learning.options import TrainingOptions
from navlearn.learning.windows import Windows, check_windows, windows_from_series

NOISE = 0.1


def cpu_seconds(work, repeats):
    """Return the least CPU time of several runs, s."""
    best = math.inf
    for _ in range(repeats):
        begin = time.process_time()
        work()
        best = min(best, time.process_time() - begin)
    return best


def benchmark_record(samples, seed=0):
    """Return inputs and outputs of a smooth nonlinear system with process noise of known size.

    The noise is fed back, so no model can predict better than it one step ahead.
    """
    generator = torch.Generator().manual_seed(seed)
    u = (2.0 * torch.rand(samples + 1, 1, generator=generator) - 1.0).double()
    noise = NOISE * torch.randn(samples + 1, generator=generator).double()
    y = [0.0, 0.0]
    levels = u[:, 0].tolist()
    for k in range(2, samples + 1):
        value = 0.5 * math.sin(1.5 * y[-1]) + 0.3 * math.tanh(2.0 * y[-2] * levels[k - 1])
        value += levels[k] ** 3 + 0.4 * math.cos(2.0 * levels[k - 1]) + float(noise[k])
        y.append(value)
    return u, torch.tensor(y).double().unsqueeze(1)


def open_loop_problem(samples, lags, hidden):
    """Return an open-loop problem over one record, and its windows and model."""
    u, y = benchmark_record(samples)
    windows = check_windows(windows_from_series(u, y, length=samples, stride=1))
    model = Anarx(AnarxOptions(inputs=1, lags=lags, hidden=hidden))
    ones = torch.ones(windows.u.shape[:2]).double()
    model.set_scaling(fit_scaling(windows.u, ones), fit_scaling(windows.y, ones))
    return AnarxLeastSquares(model, windows, closed=False), windows, model


def iteration_times(args):
    """Compare iterations of ours and of SciPy, given the same analytic Jacobian."""
    problem, windows, model = open_loop_problem(args.samples, args.lags, args.hidden)
    training = TrainingOptions(loop="open", starts=4, start_iterations=5, ridge=0.0)
    start = best_start(model, windows, problem, training).theta
    few = LmOptions(max_iterations=5, cost_tolerance=0.0)
    ours = cpu_seconds(lambda: levenberg_marquardt(problem, start, few), 3) / 5

    def residual(x):
        return problem.residuals(torch.tensor(x)).reshape(-1).numpy()

    def jacobian(x):
        w = unpack_weights(torch.tensor(x), problem.like, problem.linear_path)
        data = problem.data
        full = one_step_jacobian(w, problem.sigmoid, problem.linear_path, data.before, data.u)
        return full.reshape(-1, x.shape[0]).numpy()

    counted = []

    def peer():
        counted.append(
            least_squares(
                residual,
                start.numpy(),
                jac=jacobian,
                method="trf",
                max_nfev=4,
                ftol=None,
                xtol=1e-15,
            ).njev
        )

    begin = time.process_time()
    peer()
    scipy_time = (time.process_time() - begin) / counted[0]
    print(f"open loop, {args.samples} samples, {start.shape[0]} parameters, s per iteration")
    print(f"  ours                     {ours:8.4f}")
    print(f"  SciPy trf, same Jacobian {scipy_time:8.4f}   ratio {scipy_time / ours:.1f}")
    begin = time.process_time()
    long = levenberg_marquardt(problem, start, LmOptions(max_iterations=args.iterations))
    spent = time.process_time() - begin
    w = unpack_weights(long.theta, problem.like, problem.linear_path)
    error = model.y_scale * (
        one_step_ahead(w, problem.sigmoid, problem.data.before, problem.data.u) - problem.data.y
    )
    floor = float(error.square().mean().sqrt()) / NOISE
    print(
        f"  end point after {long.iteration} iterations ({spent:.1f} s, {long.stopped}): "
        f"{floor:.3f} of the noise floor"
    )


def closed_loop_time():
    """Time the training that precedes every outage."""
    generator = torch.Generator().manual_seed(0)
    u = torch.randn(80, 60, 5, generator=generator).double()
    noise = torch.randn(80, 60, 2, generator=generator).double()
    y = 0.05 * u[..., :2].tanh().cumsum(1) + 0.2 * u[..., 2:4] ** 2 + 0.3 * noise
    windows = Windows(u, y, torch.ones(80, 60).double(), 10.0 * torch.arange(80).double())
    part = [Windows(*(x[a:b] for x in windows[:4])) for a, b in ((0, 60), (60, 80))]
    for lags, hidden in ((2, 4), (3, 5)):
        options = AnarxOptions(inputs=5, outputs=2, lags=lags, hidden=hidden)
        begin = time.process_time()
        fitted = fit_anarx(part[0], part[1], options, TrainingOptions(), progress=False)
        spent = time.process_time() - begin
        count = sum(p.numel() for p in fitted.model.parameters())
        print(
            f"closed loop, 60 + 20 windows of 60 rows, {count} parameters: {spent:.2f} s, "
            f"{fitted.record.iterations} iterations, {fitted.record.stopped}"
        )


def free_run_iteration(args):
    """Time one closed-loop linearisation of the same record, whole and in windows."""
    u, y = benchmark_record(args.samples)
    problem, _, model = open_loop_problem(args.samples, args.lags, args.hidden)
    start = random_start(problem, torch.Generator().manual_seed(0), feedback=False)
    for length in (args.samples, 100):
        windows = check_windows(windows_from_series(u, y, length=length, stride=length))
        closed = AnarxLeastSquares(model, windows, closed=True)
        spent = cpu_seconds(lambda p=closed: p.normal_equations(start), 2)
        print(
            f"closed loop, full recurrent Jacobian, {windows.u.shape[0]} x {length} rows, "
            f"{start.shape[0]} parameters: {spent:.3f} s per iteration"
        )


def step_times():
    """Time one step of the predictor."""
    model = Anarx(AnarxOptions(inputs=5, outputs=2, lags=3, hidden=5)).requires_grad_(False)
    u = torch.zeros(5).double()
    with warnings.catch_warnings(), torch.inference_mode():
        warnings.simplefilter("ignore")
        state = model.initial_state(u)
        for name, runner in (("eager", model), ("TorchScript", torch.jit.script(model))):
            spent = cpu_seconds(lambda r=runner: [r.step(u, state) for _ in range(200)], 30)
            print(f"one step, {name:12} {spent / 200 * 1e6:6.1f} µs")


def main():
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--samples", type=int, default=10_000)
    parser.add_argument("--lags", type=int, default=3)
    parser.add_argument("--hidden", type=int, default=10)
    parser.add_argument("--iterations", type=int, default=150)
    args = parser.parse_args()
    torch.set_num_threads(1)
    step_times()
    closed_loop_time()
    free_run_iteration(args)
    iteration_times(args)


if __name__ == "__main__":
    main()
