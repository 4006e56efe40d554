"""The full-IMU filter beside the feedback filter of pyins, which linearises otherwise."""

import sys
from pathlib import Path

import pytest
import torch

sys.path.insert(0, str(Path(__file__).parents[3] / "benchmarks"))

from beside_pyins.filters import BLOCKS, errors_of, normalised_squares, run_navlearn, run_pyins
from beside_pyins.work import drawn, simulated

from navlearn.filters.consistency import mean_band

pytest.importorskip(
    "pyins",
    reason="pyins is installed from github.com/nmayorov/pyins: "
    "pip install git+https://github.com/nmayorov/pyins",
)
# pandas tells pyins of what it will drop
pytestmark = pytest.mark.filterwarnings("ignore")


def apart(work, ours, theirs):
    """Return how far apart two filters are, in deviations, and the ratio of their deviations."""
    difference = errors_of(work, ours) - errors_of(work, theirs)
    sigma = [f.covariance.diagonal(dim1=-2, dim2=-1).sqrt() for f in (ours, theirs)]
    return difference / sigma[1], sigma[0] / sigma[1]


@pytest.fixture(scope="module")
def honest():
    work = drawn(2, 160, [90])
    return work, run_pyins(work)


@pytest.mark.parametrize("method", ["exact", "fast"])
def test_tells_what_pyins_tells_through_an_outage(honest, method):
    work, theirs = honest
    ours = run_navlearn(work, method)
    assert ours.index.tolist() == theirs.index.tolist()
    deviations, ratio = apart(work, ours, theirs)
    # the first seconds bring the large errors on which linearisations differ
    assert deviations[:, 10:].square().mean().sqrt() < 0.1
    assert (ratio[:, 10:] - 1.0).abs().max() < 0.1


@pytest.mark.parametrize("grade", ["mems_m", "tactical"])
def test_errs_like_pyins_on_sensors_that_have_more_errors(grade):
    work = simulated(grade, 11, 180, [90])
    ours, theirs = (errors_of(work, run) for run in (run_navlearn(work, "exact"), run_pyins(work)))
    t = torch.arange(1, 180)
    for begin, end in ((50, 90), (90, 150), (155, 180)):
        part = (t >= begin) & (t < end)
        flat = [e[0, part, :2].norm(dim=-1).square().mean().sqrt() for e in (ours, theirs)]
        assert float(flat[0]) < 1.15 * float(flat[1]) + 0.1


@pytest.mark.slow
@pytest.mark.parametrize("run", [run_pyins, lambda work: run_navlearn(work, "exact")])
def test_is_as_good_as_it_says(run):
    work = drawn(12, 200, [110])
    for block, squares in normalised_squares(work, run(work)).items():
        part = BLOCKS[block]
        degrees = part.stop - part.start
        low, high = (x / degrees for x in mean_band(degrees, 12))
        mean = squares.mean(0)
        assert ((mean > low) & (mean < high)).double().mean() > 0.75, block
        assert low < mean.mean() < high, block
