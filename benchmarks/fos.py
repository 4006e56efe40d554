"""FOS among 6,216 candidates: seconds, memory, true terms found; and correlated inputs.

Ten channels with lags 0 to 10, second order, ten true terms, noise a tenth of the signal. Times
are CPU seconds of one thread with the lagging of the inputs in it; memory is what the highest
resident size of the process grew by. Orthogonal matching pursuit of scikit-learn runs on the same
work where it is installed; its matrix of candidates is built outside its time. Command:

    python benchmarks/fos.py [--rows 600 6000] [--repeats 5] [--seeds 5]
"""

import argparse
import resource
import time

import torch

from navlearn.error_models.fos_candidates import lagged_columns
from navlearn.error_models.fos_fit import fit_fos
from navlearn.error_models.fos_options import FosOptions

LAGS, CHANNELS, TERMS = 10, 10, 10


def highest_megabytes():
    """Return the highest resident size of the process so far, MB."""
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024


def make_work(rows, seed, correlation=0.0, noise=0.1):
    """Return inputs, target, true pairs of columns, and the columns.

    Args:
        rows: Rows with a whole past.
        seed: Seed of the draw.
        correlation: Of an input with its own past.
        noise: Standard deviation of the noise, as a share of the signal's.
    """
    generator = torch.Generator().manual_seed(seed)
    u = torch.randn(rows + LAGS, CHANNELS, generator=generator).double()
    for k in range(1, rows + LAGS):
        u[k] = correlation * u[k - 1] + (1.0 - correlation**2) ** 0.5 * u[k]
    x = lagged_columns(u, torch.zeros(rows + LAGS).double(), FosOptions(lags=LAGS))
    every = torch.triu_indices(x.shape[0], x.shape[0])
    pairs = every[:, torch.randperm(every.shape[1], generator=generator)[:TERMS]].T.tolist()
    size = 0.5 + torch.rand(TERMS, generator=generator).double()
    signal = sum(c * x[i] * x[j] for c, (i, j) in zip(size, pairs, strict=True))
    y = torch.zeros(rows + LAGS).double()
    error = torch.randn(rows, generator=generator).double()
    y[LAGS:] = signal + noise * signal.std() * error
    return u, y.unsqueeze(1), {tuple(pair) for pair in pairs}, x


def chosen_pairs(model):
    """Return the pairs of columns that a model chose."""

    def column(factor):
        channel, lag = factor
        return 1 + lag * CHANNELS + channel

    pairs = ([0] * (2 - len(term)) + [column(factor) for factor in term] for term in model.terms)
    return {tuple(pair) for pair in pairs}


def time_ours(rows, repeats):
    """Print the time, memory and terms of a fit."""
    u, y, true, _ = make_work(rows, seed=0)
    before, spent = highest_megabytes(), []
    for _ in range(repeats):
        begin = time.process_time()
        model = fit_fos(u, y, options=FosOptions(lags=LAGS, max_terms=TERMS)).model
        spent.append(time.process_time() - begin)
    grown = highest_megabytes() - before
    found = len(true & chosen_pairs(model))
    print(
        f"{rows:6} rows  ours        {min(spent):7.4f} s {grown:7.1f} MB  {found} of {TERMS} terms"
    )


def time_peer(rows, repeats):
    """Print the same for scikit-learn, its matrix counted in the memory alone."""
    try:
        from sklearn.linear_model import OrthogonalMatchingPursuit
    except ImportError:
        print(f"{rows:6} rows  scikit-learn is not installed")
        return
    _, y, true, x = make_work(rows, seed=0)
    before, spent = highest_megabytes(), []
    every = torch.triu_indices(x.shape[0], x.shape[0]).T
    matrix = (x[every[:, 0]] * x[every[:, 1]]).T.numpy()
    target = y[LAGS:, 0].numpy()
    for _ in range(repeats):
        peer = OrthogonalMatchingPursuit(n_nonzero_coefs=TERMS, fit_intercept=False)
        begin = time.process_time()
        peer.fit(matrix, target)
        spent.append(time.process_time() - begin)
    grown = highest_megabytes() - before
    found = len(true & {tuple(every[k].tolist()) for k in peer.coef_.nonzero()[0]})
    print(
        f"{rows:6} rows  sklearn OMP {min(spent):7.4f} s {grown:7.1f} MB  {found} of {TERMS} terms"
    )


def correlated_inputs(rows, seeds):
    """Print the true terms found where inputs hardly change, with and without exchange."""
    for sweeps in (0, 20):
        options = FosOptions(lags=LAGS, max_terms=TERMS, false_alarm=1.0, exchange_sweeps=sweeps)
        found, begin = [], time.process_time()
        for seed in range(seeds):
            u, y, true, _ = make_work(rows, seed, correlation=0.98, noise=0.5)
            found.append(len(true & chosen_pairs(fit_fos(u, y, options=options).model)))
        spent = (time.process_time() - begin) / seeds
        print(
            f"{rows:6} rows  correlation 0.98, noise 0.5, at most {sweeps:2} exchange sweeps: "
            f"{sum(found)} of {TERMS * seeds} terms {found}, {spent:.2f} s each with the data"
        )


def main():
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--rows", type=int, nargs="+", default=[600, 6000])
    parser.add_argument("--repeats", type=int, default=5)
    parser.add_argument("--seeds", type=int, default=5)
    args = parser.parse_args()
    torch.set_num_threads(1)
    for rows in args.rows:
        time_ours(rows, args.repeats)
    correlated_inputs(args.rows[0], args.seeds)
    for rows in args.rows:
        time_peer(rows, args.repeats)


if __name__ == "__main__":
    main()
