"""Whether the unscented filter is as good as it says: NEES and NIS inside their χ² bands."""

import sys
from dataclasses import replace

import pytest
import torch

from navlearn.filters.consistency import mean_band, nees
from navlearn.filters.unscented import UnscentedOptions
from navlearn.fusion.error_state import position_difference
from navlearn.fusion.measurements import Kind
from navlearn.fusion.unscented.loosely_coupled import LooselyCoupledUkf
from navlearn.states import NavState


def shares_in_bands(model_drives, runs, method="exact", alpha=1.0):
    """Return per quantity: its mean, its 95 % band per epoch, and the share of epochs inside."""
    options, belief, d, sensors = model_drives(runs, 60, 11)
    options = replace(options, unscented=UnscentedOptions(alpha=alpha))
    with torch.no_grad():
        history = LooselyCoupledUkf(options)(belief, d.samples, d.fixes, d.timing, method=method)
    truth = NavState(*(torch.gather(x.expand(runs, -1), 1, history.end) for x in d.truth[:4]))
    at = history.belief
    turn = (at.state.azimuth - truth.azimuth).unsqueeze(-1)
    error = torch.cat((position_difference(at.state, truth), turn, at.sensor - sensors), -1)
    table = {}
    for name, values, degrees in (
        ("NEES", nees(error, at.covariance), 7),
        ("NIS of position", history.nis[..., Kind.POSITION], 3),
        ("NIS of velocity", history.nis[..., Kind.VELOCITY], 3),
    ):
        band, epochs = mean_band(degrees, runs), values.mean(0)
        inside = (epochs > band.low) & (epochs < band.high)
        table[name] = (float(epochs.mean()), band, float(inside.double().mean()))
        if name != "NEES":
            # innovations of an honest filter are white: all of them are independent squares
            whole = mean_band(degrees, values.numel(), 0.999)
            assert whole.low < table[name][0] < whole.high, name
    for name, (mean, band, share) in table.items():
        limits = f"95 % band {band.low:.3f} to {band.high:.3f}"
        sys.stdout.write(f"{name:16} {mean:6.3f}, {limits}, {share:.0%} of epochs inside\n")
    return table


@pytest.mark.parametrize("alpha", [1.0, 1e-3])
def test_the_unscented_filter_is_as_good_as_it_says(model_drives, alpha):
    for name, (_, _, share) in shares_in_bands(model_drives, 20, alpha=alpha).items():
        assert share > 0.8, name


@pytest.mark.slow
@pytest.mark.parametrize("method", ["exact", "sequential"])
def test_it_is_as_good_as_it_says_over_a_hundred_runs(model_drives, method):
    for name, (mean, band, share) in shares_in_bands(model_drives, 100, method).items():
        assert band.low < mean < band.high, name
        # errors stay for long: that NEES of one epoch is outside, its neighbours' are
        assert share > (0.85 if name == "NEES" else 0.9), name
