"""PCI: time of a refit, cascades accepted on noise, recovery of known cascades, and peers.

Times are CPU seconds of one thread. The windows are those of a refit while driving: 300 s at 1 Hz
and 60 s at 10 Hz, eleven lags. `paper` is the model of the paper, `default` tests for what was
fitted, fits all polynomials again and polishes the responses. Held-out errors are RMS against the
noiseless output, as a share of its spread. No package does PCI: the peers identify the same sum of
cascades as a polynomial of third degree of the lagged inputs, of at most 40 terms where they choose
any. Their times and ours are those of the fit and of the output over rows of training and held-out
rows, the peers' table of products in them. Command:

    python benchmarks/pci.py [--repeats 3] [--windows 32] [--draws 200] [--rows 600 3000]
        [--seeds 3]
"""

import argparse
import functools
import itertools
import time

import torch

from navlearn.error_models.pci import PciOptions
from navlearn.error_models.pci_fit import fit_pci, fit_pci_windows
from navlearn.error_models.volterra import volterra_kernels

LAGS, CASCADES, NOISE, HELD_OUT = 10, 3, 0.2, 2000
MOST = 40  # terms that a peer may choose
KINDS = {"paper": PciOptions.paper, "default": PciOptions}


def lagged_inputs(x):
    """Return lags 0 to LAGS of every channel, zeros before the start, shape (T, (R + 1) m)."""
    padded = torch.cat((torch.zeros(LAGS, x.shape[1]).double(), x))
    return padded.unfold(0, LAGS + 1, 1).flip(-1).transpose(-1, -2).flatten(1)


def make_work(rows, seed, channels=1, cascades=CASCADES, noise=NOISE):
    """Return inputs, noiseless output, noisy output, responses and powers of the cascades."""
    generator = torch.Generator().manual_seed(seed)
    x = torch.randn(rows, channels, generator=generator).double()
    fade = torch.exp(-torch.arange(LAGS + 1) / 3.0).repeat_interleave(channels).double()
    response = fade * torch.randn(cascades, fade.shape[0], generator=generator).double()
    response = response / response.norm(dim=-1, keepdim=True)
    powers = torch.randn(cascades, 3, generator=generator).double()
    powers = powers * torch.tensor([1.0, 0.5, 0.2])
    v = lagged_inputs(x) @ response.T
    clean = sum(powers[:, d] * v ** (d + 1) for d in range(3)).sum(-1)
    powers, clean = powers / clean.std(), clean / clean.std()
    return (
        x,
        clean,
        clean + noise * torch.randn(rows, generator=generator).double(),
        response,
        powers,
    )


def seconds(work, repeats):
    """Return the least CPU time of some repeats, and the last result."""
    spent = []
    for _ in range(repeats):
        begin = time.process_time()
        result = work()
        spent.append(time.process_time() - begin)
    return min(spent), result


def time_refits(windows, repeats):
    """Print the time of one refit, and of one among many at once."""
    print(f"{'refit':24}{'alone':>12}{'of ' + str(windows):>12}{'ratio':>8}{'cascades':>10}")
    for what, rows in (("300 s at 1 Hz", 300), ("60 s at 10 Hz", 600)):
        work = [make_work(rows, seed) for seed in range(windows)]
        x, y = (torch.stack([each[k] for each in work]) for k in (0, 2))
        for kind, options in KINDS.items():
            chosen = options(lags=LAGS)
            alone, fitted = seconds(
                lambda x=x, y=y, o=chosen: [fit_pci(a, b, o) for a, b in zip(x, y, strict=True)],
                repeats,
            )
            together, _ = seconds(lambda x=x, y=y, o=chosen: fit_pci_windows(x, y, o), repeats)
            found = sum(each.cascades for each in fitted) / windows
            print(
                f"{what + ', ' + kind:24}{1e3 * alone / windows:9.2f} ms"
                f"{1e3 * together / windows:9.2f} ms{alone / together:8.2f}{found:10.1f}"
            )


def accepted_on_noise(draws):
    """Print how often noise is taken for a system."""
    print(f"\n{'noise, 600 rows':36}{'draws with any':>16}{'cascades each':>15}")
    for memory, shown in ((0.0, "white input"), (0.9, "input remembers 0.9")):
        generator = torch.Generator().manual_seed(12)
        x = torch.randn(draws, 600, 1, generator=generator).double()
        y = torch.randn(draws, 600, generator=generator).double()
        for k in range(1, 600):
            x[:, k] = memory * x[:, k - 1] + (1.0 - memory**2) ** 0.5 * x[:, k]
        for kind, options in KINDS.items():
            counts = [fitted.cascades for fitted in fit_pci_windows(x, y, options(lags=LAGS))]
            taken = sum(count > 0 for count in counts)
            print(f"{shown + ', ' + kind:36}{taken:9} of {draws}{sum(counts) / draws:15.2f}")


def recover(repeats):
    """Print how near two noiseless cascades and their Volterra kernels come."""
    x, clean, _, response, powers = make_work(1000 + HELD_OUT, 1, cascades=2, noise=0.0)
    head = f"{'held out':>12}{'kernels':>12}{'cascades':>10}{'time':>12}"
    print(f"\n{'two cascades, 1000 rows':24}{head}")
    for kind, options in {
        **KINDS,
        "paper, 200 cascades": lambda **given: PciOptions.paper(cascades=200, misses=200, **given),
        "default, unpolished": lambda **given: PciOptions(polish=0, cascades=60, **given),
    }.items():
        chosen = options(lags=LAGS, safeguard=False)
        spent, fitted = seconds(lambda o=chosen: fit_pci(x[:1000], clean[:1000], o), repeats)
        kernels = volterra_kernels(fitted.model)
        known = (
            torch.einsum("k,ka->a", powers[:, 0], response),
            torch.einsum("k,ka,kb->ab", powers[:, 1], response, response),
            torch.einsum("k,ka,kb,kc->abc", powers[:, 2], response, response, response),
        )
        off = max(
            float((found.reshape(true.shape) - true).norm() / true.norm())
            for found, true in zip(kernels[1:], known, strict=True)
        )
        left = held_out(fitted.model(x)[:, 0], clean, 1000)
        print(f"{kind:24}{left:12.1e}{off:12.1e}{fitted.cascades:10}{1e3 * spent:9.1f} ms")


def held_out(found, clean, rows):
    """Return the RMS error after the rows of training, as a share of the spread."""
    error = (found - clean)[rows + LAGS :]
    return float(error.square().mean().sqrt() / clean[rows + LAGS :].std())


def ours(kind, x, y, rows):
    """Fit PCI; return its output and its size."""
    options = KINDS[kind](inputs=x.shape[1], lags=LAGS)
    fitted = fit_pci(x[:rows], y[:rows], options)
    return fitted.model(x)[:, 0], str(fitted.cascades)


def third_powers(x):
    """Return all products of up to three lagged inputs, shape (T, F)."""
    from sklearn.preprocessing import PolynomialFeatures

    return PolynomialFeatures(3).fit_transform(lagged_inputs(x).numpy())


def ridge(x, y, rows):
    """Fit all products by scikit-learn's ridge with cross-validated penalty."""
    from sklearn.linear_model import RidgeCV

    table = third_powers(x)
    peer = RidgeCV([10.0**k for k in range(-1, 5)]).fit(table[LAGS:rows], y[LAGS:rows].numpy())
    return torch.from_numpy(peer.predict(table)), str(table.shape[1])


def matching_pursuit(x, y, rows):
    """Choose products by scikit-learn's orthogonal matching pursuit, cross-validated."""
    from sklearn.linear_model import OrthogonalMatchingPursuitCV

    table = third_powers(x)[:, 1:]
    peer = OrthogonalMatchingPursuitCV(cv=5, max_iter=MOST).fit(
        table[LAGS:rows], y[LAGS:rows].numpy()
    )
    return torch.from_numpy(peer.predict(table)), str(peer.n_nonzero_coefs_)


def frols(x, y, rows):
    """Choose products by SysIdentPy's FROLS with its information criterion."""
    from sysidentpy.basis_function import Polynomial
    from sysidentpy.model_structure_selection import FROLS
    from sysidentpy.parameter_estimation import LeastSquares

    lags = list(range(1, LAGS + 2))
    peer = FROLS(
        order_selection=True,
        n_info_values=MOST,
        info_criteria="bic",
        ylag=1,
        xlag=lags if x.shape[1] == 1 else [lags] * x.shape[1],
        basis_function=Polynomial(degree=3),
        estimator=LeastSquares(),
        model_type="NFIR",
    )
    # Their lags begin at one: an input that comes a row later has lag zero.
    later = torch.cat((x[1:], x[-1:])).numpy()
    target = y.unsqueeze(-1).numpy()
    peer.fit(X=later[:rows], y=target[:rows])
    return torch.from_numpy(peer.predict(X=later, y=target))[:, 0], str(len(peer.final_model))


def beside_peers(rows_list, seeds):
    """Print least time, mean held-out error and sizes of everybody on sums of three cascades."""
    everybody = {
        "PCI default": functools.partial(ours, "default"),
        "PCI paper": functools.partial(ours, "paper"),
        "scikit-learn ridge": ridge,
        "scikit-learn OMP": matching_pursuit,
        "SysIdentPy FROLS": frols,
    }
    print(f"\n{'three cascades, noise 0.2':42}{'time':>12}{'held out':>10}  cascades or terms")
    for channels, rows in itertools.product((1, 2), rows_list):
        for name, fit in everybody.items():
            label = f"{channels} in, {rows} rows, {name}"
            spent, left, sizes = [], [], []
            try:
                for seed in range(seeds):
                    x, clean, y, _, _ = make_work(rows + HELD_OUT, seed, channels)
                    once, (found, size) = seconds(functools.partial(fit, x, y, rows), 1)
                    spent.append(once)
                    left.append(held_out(found, clean, rows))
                    sizes.append(size)
            except ImportError as missing:
                print(f"{label:42}  {missing.name} is not installed")
                continue
            mean = sum(left) / seeds
            print(f"{label:42}{1e3 * min(spent):9.1f} ms{mean:10.3f}  {', '.join(sizes)}")


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--repeats", type=int, default=3)
    parser.add_argument("--windows", type=int, default=32)
    parser.add_argument("--draws", type=int, default=200)
    parser.add_argument("--rows", type=int, nargs="+", default=[600, 3000])
    parser.add_argument("--seeds", type=int, default=3)
    args = parser.parse_args()
    torch.set_num_threads(1)
    time_refits(args.windows, args.repeats)
    accepted_on_noise(args.draws)
    recover(args.repeats)
    beside_peers(args.rows, args.seeds)


if __name__ == "__main__":
    main()
