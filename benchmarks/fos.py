"""FOS: seconds of a refit, from scratch, sliding, many windows at once; and what noise makes of it.

Four parts, CPU time of one thread, with the lagging of the inputs in it:
    large    6,216 candidates (ten channels, lags 0 to 10, second order), ten true terms, noise a
             tenth of the signal; ``fos_peers.py`` sets others beside it
    refit    a window of 60 s, refitted after each new second: by ``fit_fos`` and by ``SlidingFos``
    batch    windows one after another, and all at once
    noise    white noise as target, inputs white and coloured: draws of 200 in which any term was
             accepted, and terms per draw, by both rules of acceptance
Command:

    python benchmarks/fos.py [--rows 600 6000] [--repeats 5] [--draws 200] [--parts large refit ...]
"""

import argparse
import time

import torch

from navlearn.error_models.fos_candidates import lagged_columns
from navlearn.error_models.fos_fit import fit_fos, fit_fos_batch
from navlearn.error_models.fos_options import FosOptions
from navlearn.error_models.fos_sliding import SlidingFos

LAGS, CHANNELS, TERMS = 10, 10, 10


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


def seconds_of(work, repeats):
    """Return the least CPU time of a piece of work, s."""
    spent = []
    for _ in range(repeats):
        begin = time.process_time()
        work()
        spent.append(time.process_time() - begin)
    return min(spent)


def large(args):
    print("large: rows, seconds, true terms found")
    for rows in args.rows:
        u, y, true, _ = make_work(rows, seed=0)
        options = FosOptions(lags=LAGS, max_terms=TERMS)
        found = len(true & chosen_pairs(fit_fos(u, y, options=options).model))
        spent = seconds_of(lambda u=u, y=y, o=options: fit_fos(u, y, options=o), args.repeats)
        print(f"{rows:6} {spent:8.4f} s  {found} of {TERMS}")


def slide_and_refit(inputs, window, step, options, refits):
    """Return the mean CPU seconds of a refit from scratch, and sliding with its pushes."""
    generator = torch.Generator().manual_seed(0)
    rows = window + step * (refits + 1)
    u = torch.randn(rows, inputs, generator=generator).double()
    y = u[:, :1] * u[:, 1:2] + 0.7 * u[:, 2:3] + 0.5 * u[:, :1] * u[:, 2:3]
    y = 0.3 + y + 0.5 * torch.randn(rows, 1, generator=generator).double()
    sliding, spent = SlidingFos(inputs, window, options), [0.0, 0.0]
    sliding.push(u[:window], y[:window])
    sliding.fit()
    for k in range(refits + 1):
        rows = slice(window + k * step, window + (k + 1) * step)
        begin = time.process_time()
        sliding.push(u[rows], y[rows])
        carried = sliding.fit()
        middle = time.process_time()
        last = slice(rows.stop - window, rows.stop)
        anew = fit_fos(u[last], y[last], options=options)
        end = time.process_time()
        if carried.model.terms != anew.model.terms:
            raise SystemExit("sliding and scratch chose other terms")
        if k > 0:
            spent[0] += (end - middle) / refits
            spent[1] += (middle - begin) / refits
    return spent


def refit(args):
    print("refit of a 60 s window, at most 8 terms, 4 true: candidates, scratch, sliding, ratio")
    paper, many = FosOptions(lags=1, max_terms=8), FosOptions(lags=LAGS, max_terms=8)
    for title, inputs, window, step, options in (
        ("1 Hz, 60 rows, 3 inputs", 3, 60, 1, paper),
        ("10 Hz, 600 rows, 3 inputs", 3, 600, 10, paper),
        ("10 Hz, 600 rows, 9 inputs", 9, 600, 10, paper),
        ("10 Hz, 600 rows, 10 inputs, lags 0 to 10", 10, 600, 10, many),
        ("100 Hz, 6000 rows, 9 inputs", 9, 6000, 100, paper),
        ("100 Hz, 6000 rows, 10 inputs, lags 0 to 10", 10, 6000, 100, many),
    ):
        columns = 1 + inputs * (options.lags + 1)
        size = columns * (columns + 1) // 2
        scratch, carried = slide_and_refit(inputs, window, step, options, 4 * args.repeats)
        print(
            f"{title:42} {size:5} {1e3 * scratch:7.2f} ms {1e3 * carried:7.2f} ms "
            f"{scratch / carried:5.1f}"
        )


def batch(args):
    print("windows at once, at most 8 terms: one by one, together, ratio")
    options = FosOptions(lags=1, max_terms=8, false_alarm=1.0)
    generator = torch.Generator().manual_seed(0)
    for windows, rows, inputs in ((64, 60, 3), (64, 600, 3), (16, 600, 9)):
        u = torch.randn(windows, rows, inputs, generator=generator).double()
        y = u[..., :1] * u[..., 1:2] + torch.randn(windows, rows, 1, generator=generator).double()
        pairs = list(zip(u, y, strict=True))
        alone = seconds_of(lambda p=pairs: [fit_fos(*one, options=options) for one in p], 2)
        together = seconds_of(lambda u=u, y=y: fit_fos_batch(u, y, options=options), args.repeats)
        print(
            f"{windows:4} windows, {rows:4} rows, {inputs:2} inputs {1e3 * alone:8.1f} ms "
            f"{1e3 * together:8.1f} ms {alone / together:5.1f}"
        )


def noise_terms(draws, rows, inputs, lags, colour, acceptance):
    """Return the number of terms accepted in each draw of white noise as target."""
    generator = torch.Generator().manual_seed(7)
    options = FosOptions(lags=lags, max_terms=8, acceptance=acceptance)
    counts = []
    while len(counts) < draws:
        size = min(20, draws - len(counts))
        u = torch.randn(size, rows, inputs, generator=generator).double()
        for k in range(1, rows):
            u[:, k] = colour * u[:, k - 1] + (1.0 - colour**2) ** 0.5 * u[:, k]
        y = torch.randn(size, rows, 1, generator=generator).double()
        counts += [len(one.model.terms) for one in fit_fos_batch(u, y, options=options)]
    return counts


def noise(args):
    print(f"white noise as target: of {args.draws} draws, with any term; terms per draw")
    for rows, inputs, lags in ((60, 1, 1), (60, 3, 1), (60, 9, 1), (600, 9, 1), (600, 10, 10)):
        columns = 1 + inputs * (lags + 1)
        for colour in (0.0, 0.98):
            line = f"{rows:4} rows {columns * (columns + 1) // 2:5} candidates, inputs {colour:4}: "
            for rule in ("default", "paper"):
                counts = noise_terms(args.draws, rows, inputs, lags, colour, rule)
                some = sum(count > 0 for count in counts)
                line += f"  {rule} {some:3}, {sum(counts) / len(counts):4.2f}"
            print(line)


PARTS = {"large": large, "refit": refit, "batch": batch, "noise": noise}


def main():
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--rows", type=int, nargs="+", default=[600, 6000])
    parser.add_argument("--repeats", type=int, default=5)
    parser.add_argument("--draws", type=int, default=200)
    parser.add_argument("--parts", nargs="+", choices=sorted(PARTS), default=list(PARTS))
    args = parser.parse_args()
    torch.set_num_threads(1)
    for part in args.parts:
        PARTS[part](args)


if __name__ == "__main__":
    main()
