"""The smoother of the unscented filter: against the extended one's, and against the truth."""

from dataclasses import replace

import pytest
import torch

from navlearn.filters.consistency import mean_band, nees
from navlearn.filters.unscented import UnscentedOptions
from navlearn.frames import enu_between
from navlearn.fusion.error_state import initial_belief, position_difference
from navlearn.fusion.filters_of import riss_filter
from navlearn.fusion.gate_options import GateOptions
from navlearn.fusion.measurements import Kind
from navlearn.fusion.options import EkfOptions
from navlearn.fusion.smoothing import SmoothingOptions, smooth
from navlearn.states import GnssFix, NavState, RissSample


def smoothed(options, d, method="exact", passes=1):
    filter_, start = riss_filter(options), initial_belief(options, d.start)
    with torch.no_grad():
        history = filter_(start, d.samples, d.fixes, d.timing, method=method)
        return history, smooth(
            filter_, start, d.samples, d.fixes, d.timing, history, SmoothingOptions(passes=passes)
        )


@pytest.mark.parametrize("model", ["bias_scale", "shen2010_full"])
@pytest.mark.parametrize("alpha", [0.1, 1e-3])
def test_it_is_the_extended_smoother_where_little_is_bent(make_drive, model, alpha):
    d = make_drive(seconds=12, rate=5)
    plain = EkfOptions(model=model)
    _, extended = smoothed(plain, d)
    history, found = smoothed(replace(plain, unscented=UnscentedOptions(alpha=alpha)), d)
    assert found.passes == 1
    for a, b in (
        (found.trajectory, extended.trajectory),
        (found.belief.state, extended.belief.state),
    ):
        assert max(float(x.abs().max()) for x in enu_between(*a[:3], *b[:3])) < 0.05
    torch.testing.assert_close(
        found.belief.covariance, extended.belief.covariance, rtol=0.1, atol=2e-3
    )
    last = history.belief.covariance[:, -1]
    torch.testing.assert_close(found.belief.covariance[:, -1], last)
    sigma = found.belief.covariance.diagonal(dim1=-2, dim2=-1)
    assert bool((sigma <= history.belief.covariance.diagonal(dim1=-2, dim2=-1) * 1.0001).all())


def test_a_single_drive_is_a_batch_of_one(make_drive):
    d = make_drive(seconds=5, rate=5)
    options = EkfOptions(unscented=UnscentedOptions())
    _, many = smoothed(options, d)
    one = type(d)(
        NavState(*(x[0] for x in d.start)),
        d.truth,
        RissSample(*(x[0] for x in d.samples)),
        GnssFix(*(x[0] for x in d.fixes)),
        type(d.timing)(*(x[0] for x in d.timing)),
    )
    _, alone = smoothed(options, one)
    torch.testing.assert_close(alone.belief.covariance, many.belief.covariance[0])
    for a, b in zip(alone.trajectory, many.trajectory, strict=True):
        torch.testing.assert_close(a, b[0])


def test_a_reset_cuts_what_came_before(make_drive):
    """A jump of 100 m that the gate takes after three refusals: neither side hears of the other."""
    d = make_drive(seconds=12, rate=5)
    lat = d.fixes.lat.clone()
    lat[0, 5:] += 100.0 / 6.4e6
    d = d._replace(fixes=d.fixes._replace(lat=lat))
    options = EkfOptions(unscented=UnscentedOptions(), gate=GateOptions(reset_after=3))
    history, found = smoothed(options, d)
    assert int(history.resets[0, Kind.POSITION]) == 1
    north = position_difference(found.belief.state, history.belief.state)[0, :, 1]
    assert float(north[:5].abs().max()) < 5.0


def test_it_is_as_good_as_it_says(model_drives):
    runs = 20
    options, belief, d, sensors = model_drives(runs, 25, 11)
    options = replace(options, unscented=UnscentedOptions())
    ukf = riss_filter(options)
    with torch.no_grad():
        history = ukf(belief, d.samples, d.fixes, d.timing)
        found = smooth(ukf, belief, d.samples, d.fixes, d.timing, history)
    truth = NavState(*(torch.gather(x.expand(runs, -1), 1, history.end) for x in d.truth[:4]))
    square = {}
    for name, at in (("filter", history.belief), ("smoother", found.belief)):
        turn = (at.state.azimuth - truth.azimuth).unsqueeze(-1)
        error = torch.cat((position_difference(at.state, truth), turn, at.sensor - sensors), -1)
        square[name] = error[..., :2].square().mean()
        epochs, band = nees(error, at.covariance).mean(0), mean_band(7, runs)
        assert float(((epochs > band.low) & (epochs < band.high)).double().mean()) > 0.8, name
    assert float(square["smoother"]) < 0.6 * float(square["filter"])
