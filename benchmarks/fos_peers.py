"""FOS beside SysIdentPy, scikit-learn and fastcan, on the same work, in one run.

Work: ten channels with lags 0 to 10, second order (6,216 candidates), ten true terms of them,
noise a tenth of the signal; then the hard case, inputs that hardly change from row to row
(first-order autoregressive, coefficient 0.98) under heavy noise, five draws. Every method runs in
a process of its own on one thread. Seconds are CPU time of the fit, the least of the repeats, and
for methods that take their candidates as a matrix, of building it; megabytes are the peak
resident size over that just before, with data and packages loaded. The error is what the chosen
terms leave of the target after least squares, over what the true terms leave (root mean squares).
A method that is not installed says so; the extra ``peers`` installs them. Command:

    python benchmarks/fos_peers.py [--rows 600 6000] [--repeats 5] [--noise 0.2 0.3 0.5] [--seeds 5]
"""

import argparse
import importlib.util
import json
import os
import resource
import subprocess
import sys
import time
import warnings
from pathlib import Path

KICKS = 8
ONE_THREAD = dict.fromkeys(("OMP_NUM_THREADS", "MKL_NUM_THREADS", "OPENBLAS_NUM_THREADS"), "1")
os.environ.update(ONE_THREAD)

import numpy as np  # noqa: E402
import torch  # noqa: E402
from fos import CHANNELS, LAGS, TERMS, chosen_pairs, make_work  # noqa: E402

from navlearn.error_models.fos_candidates import lagged_columns  # noqa: E402
from navlearn.error_models.fos_fit import fit_fos  # noqa: E402
from navlearn.error_models.fos_options import FosOptions  # noqa: E402


def build_matrix(u):
    """Return every candidate as a column, and its pair of lagged columns."""
    x = lagged_columns(u, u[:, 0], FosOptions(lags=LAGS)).numpy()
    left, right = np.triu_indices(x.shape[0])
    return (x[left] * x[right]).T, np.stack([left, right], 1)


def ours(u, y, sweeps=0, kicks=0):
    options = FosOptions(
        lags=LAGS, max_terms=TERMS, false_alarm=1.0, exchange_sweeps=sweeps, kicks=kicks
    )
    return chosen_pairs(fit_fos(u, y, options=options).model), 0.0


def ours_with_exchange(u, y):
    return ours(u, y, sweeps=20)


def ours_with_kicks(u, y):
    return ours(u, y, sweeps=20, kicks=KICKS)


def frols(u, y):
    from sysidentpy.basis_function import Polynomial
    from sysidentpy.model_structure_selection import FROLS
    from sysidentpy.parameter_estimation import LeastSquares

    # Its lags begin at 1: the target goes one row back, so that lag 1 is the row itself.
    shifted = np.vstack([u.numpy(), np.zeros((1, CHANNELS))])
    model = FROLS(
        order_selection=False,
        n_terms=TERMS,
        xlag=[list(range(1, LAGS + 2))] * CHANNELS,
        ylag=1,
        estimator=LeastSquares(),
        basis_function=Polynomial(degree=2),
        model_type="NFIR",
    )
    model.fit(X=shifted, y=np.vstack([[[0.0]], y.numpy()]))

    def column(code):
        return 1 + (code % 1000 - 1) * CHANNELS + code // 1000 - 2 if code else 0

    return {tuple(sorted(column(int(c)) for c in row)) for row in model.final_model}, 0.0


def matching_pursuit(u, y):
    from sklearn.linear_model import OrthogonalMatchingPursuit

    begin = time.process_time()
    matrix, pairs = build_matrix(u)
    matrix /= np.linalg.norm(matrix, axis=0)
    built = time.process_time() - begin
    model = OrthogonalMatchingPursuit(n_nonzero_coefs=TERMS, fit_intercept=False)
    model.fit(matrix, y[LAGS:, 0].numpy())
    return {tuple(pairs[k].tolist()) for k in model.coef_.nonzero()[0]}, built


def fast_can(u, y, beam=1):
    from fastcan import FastCan

    begin = time.process_time()
    matrix, pairs = build_matrix(u)
    built = time.process_time() - begin
    # It takes out the mean itself; the constant is no candidate.
    model = FastCan(TERMS, beam_width=beam, tol=1e-7, verbose=0)
    model.fit(matrix[:, 1:], y[LAGS:].numpy())
    return {tuple(pairs[k + 1].tolist()) for k in model.indices_}, built


def fast_can_beam(u, y):
    return fast_can(u, y, beam=10)


METHODS = {
    "ours": ("navlearn FOS", ours, "navlearn"),
    "exchange": ("navlearn FOS, exchange", ours_with_exchange, "navlearn"),
    "kicks": ("navlearn FOS, + kicks", ours_with_kicks, "navlearn"),
    "omp": ("scikit-learn OMP", matching_pursuit, "sklearn"),
    "fastcan": ("fastcan", fast_can, "fastcan"),
    "beam": ("fastcan, beam of 10", fast_can_beam, "fastcan"),
    "frols": ("SysIdentPy FROLS", frols, "sysidentpy"),
}


def left_over(u, y, pairs):
    """Return the root mean square that some terms leave of the target."""
    x = lagged_columns(u, u[:, 0], FosOptions(lags=LAGS)).numpy()
    columns = np.stack([x[i] * x[j] for i, j in sorted(pairs)], 1)
    target = y[LAGS:, 0].numpy()
    return float(np.std(target - columns @ np.linalg.lstsq(columns, target, rcond=None)[0]))


def run_method(name, rows, repeats, seeds, correlation, noise):
    """Return seconds, seconds of building, megabytes, terms found and errors of one method."""
    warnings.simplefilter("ignore")
    method = METHODS[name][1]
    result = {"spent": [], "built": [], "found": [], "error": []}
    work = [make_work(rows, seed, correlation, noise)[:3] for seed in range(seeds)]
    method(*make_work(40, 0)[:2])
    pages = int(Path("/proc/self/statm").read_text().split()[1])
    for u, y, true in work:
        spent, built = [], []
        for _ in range(repeats):
            begin = time.process_time()
            pairs, build = method(u, y)
            spent.append(time.process_time() - begin - build)
            built.append(build)
        result["spent"].append(min(spent))
        result["built"].append(min(built))
        result["found"].append(len(true & pairs))
        result["error"].append(left_over(u, y, pairs) / left_over(u, y, true))
    result["grown"] = (
        resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
        - pages * resource.getpagesize() / 2**20
    )
    return result


def run_apart(name, *numbers):
    """Run a method in a process of its own; None where it is not installed."""
    if importlib.util.find_spec(METHODS[name][2]) is None:
        return None
    command = [sys.executable, __file__, "--apart", name, *map(str, numbers)]
    environment = {**os.environ, **ONE_THREAD}
    ran = subprocess.run(command, capture_output=True, text=True, env=environment, check=True)
    return json.loads(ran.stdout.splitlines()[-1])


def print_speed(rows, repeats):
    print(f"\n{rows} rows, noise 0.1    fit, s  matrix, s  peak, MB  terms of {TERMS}  error")
    for name in ("ours", "omp", "fastcan", "frols"):
        title, _, package = METHODS[name]
        result = run_apart(name, rows, repeats, 1, 0.0, 0.1)
        if result is None:
            print(f"{title:22} {package} is not installed")
            continue
        print(
            f"{title:22} {result['spent'][0]:7.4f} {result['built'][0]:10.3f} "
            f"{result['grown']:9.1f} {result['found'][0]:12} {result['error'][0]:6.3f}"
        )


def print_hard_case(noise, seeds):
    total = TERMS * seeds
    print(f"\nautoregressive 0.98, 600 rows, noise {noise:g}")
    print(f"{'':22}    fit, s  terms of {total:3}  {'by draw':{4 * seeds}}  error")
    for name, (title, _, package) in METHODS.items():
        result = run_apart(name, 600, 1, seeds, 0.98, noise)
        if result is None:
            print(f"{title:22} {package} is not installed")
            continue
        mean = sum(result["error"]) / seeds
        spent = sum(result["spent"]) / seeds
        print(
            f"{title:22} {spent:9.4f} {sum(result['found']):13}  "
            f"{result['found']!s:{4 * seeds}} {mean:6.3f}"
        )


def main():
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--rows", type=int, nargs="*", default=[600, 6000])
    parser.add_argument("--repeats", type=int, default=5)
    parser.add_argument("--noise", type=float, nargs="*", default=[0.2, 0.3, 0.5])
    parser.add_argument("--seeds", type=int, default=5)
    parser.add_argument("--apart", nargs=6, help=argparse.SUPPRESS)
    args = parser.parse_args()
    torch.set_num_threads(1)
    if args.apart:
        name, rows, repeats, seeds, correlation, noise = args.apart
        counts = int(rows), int(repeats), int(seeds)
        print(json.dumps(run_method(name, *counts, float(correlation), float(noise))))
        return
    for rows in args.rows:
        print_speed(rows, args.repeats)
    for noise in args.noise:
        print_hard_case(noise, args.seeds)


if __name__ == "__main__":
    main()
