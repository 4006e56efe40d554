"""The tight filter by sigma points: beside the extended one, and itself."""

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import pytest
import torch
from torch import Tensor

from navlearn.errors import ConfigError, LogError
from navlearn.filters.tight_belief import map_tight_belief, map_tree
from navlearn.filters.unscented import UnscentedOptions
from navlearn.frames import ecef_from_geodetic, enu_between, enu_from_ecef_matrix
from navlearn.fusion.measurements import Verdict
from navlearn.fusion.options import EkfOptions
from navlearn.fusion.tight.history import TightHistory
from navlearn.fusion.tight.module import TightEkf
from navlearn.fusion.tight.riss_vehicle import RissVehicle
from navlearn.states import RissSample, SatelliteRanges


def pointed(options: Any, alpha: float = 0.5) -> Any:
    return replace(options, unscented=UnscentedOptions(alpha=alpha))


def assert_same(found: Any, wanted: Any, **tolerance: float) -> None:
    if isinstance(found, Tensor):
        torch.testing.assert_close(found, wanted, equal_nan=True, **tolerance)
    elif isinstance(found, tuple):
        for one, other in zip(found, wanted, strict=True):
            assert_same(one, other, **tolerance)


def run(d: Any, options: Any, method: str = "exact", **changed: Tensor) -> TightHistory:
    ekf = TightEkf(RissVehicle(options), systems=2)
    with torch.no_grad():
        history: TightHistory = ekf(
            d.start, d.samples, d.ranges._replace(**changed), d.timing, method=method
        )
    return history


def metres(one: TightHistory, other: TightHistory, first: int = 0) -> float:
    way = torch.stack(enu_between(*one.trajectory[:3], *other.trajectory[:3]))
    return float(way[..., first:].norm(dim=0).max())


def test_is_the_extended_filter_where_ranges_are_good(range_drive: Callable[..., Any]) -> None:
    """Ranges are nearly linear: what differs comes of the car, and goes with its azimuth known."""
    d = range_drive(seconds=30, seed=3)
    wide, narrow, linear = (
        run(d, o) for o in (pointed(d.options, 1.0), pointed(d.options, 1e-3), d.options)
    )
    assert wide.method == "exact"
    for history in (wide, narrow):
        assert torch.equal(history.verdict, linear.verdict)
        assert torch.equal(history.own_verdict, linear.own_verdict)
        assert metres(history, linear) < 0.1
        assert metres(history, linear, 400) < 0.03
        sigma = linear.belief.covariance.diagonal(dim1=-2, dim2=-1).sqrt()
        scaled = (history.belief.covariance - linear.belief.covariance) / (
            sigma.unsqueeze(-1) * sigma.unsqueeze(-2)
        )
        assert float(scaled[:, 20:].abs().max()) < 0.02
        assert_same(history.innovation[:, 20:], linear.innovation[:, 20:], atol=0.05, rtol=0.0)
        assert_same(history.residual[:, 20:], linear.residual[:, 20:], atol=0.05, rtol=0.0)
        assert_same(history.spread[:, 20:], linear.spread[:, 20:], atol=0.0, rtol=0.01)


def test_points_tell_of_ranges_what_a_second_derivative_does(
    range_drive: Callable[..., Any],
) -> None:
    """Of a position known to a kilometre the mean distance is longer, and the Earth is round."""
    d = range_drive(seconds=1, noise=None, offsets=(0.0,))
    start = TightEkf(RissVehicle(d.options)).start(d.start, 8)
    n = d.start.covariance.shape[-1]
    variance = start.covariance.diagonal(dim1=-2, dim2=-1).clone()
    variance[:, :n] = 1e-12
    variance[:, :3] = 1e6
    covariance = torch.diag_embed(variance)
    vehicle = start.vehicle._replace(covariance=covariance[:, :n, :n])
    start = start._replace(vehicle=vehicle, covariance=covariance)
    seen = []
    for options in (d.options, pointed(d.options, 1.0)):
        with torch.no_grad():
            ekf = TightEkf(RissVehicle(options))
            seen.append(ekf(start, d.samples, d.ranges, d.timing).innovation[0, 0])
    place = ecef_from_geodetic(*(x[0, 19] for x in d.truth[:3]))
    away = d.ranges.satellite[0, 0] - place
    distance = torch.linalg.vector_norm(away, dim=-1)
    lat, lon = (x[0, 19] for x in d.truth[:2])
    unit = (away / distance.unsqueeze(-1)) @ enu_from_ecef_matrix(lat, lon).mT
    # (I − u uᵀ)/ρ has the trace 2/ρ; level ways fall below the horizon by half their square/R, and
    # a way east, along its parallel, bends to the north
    fallen = unit[:, 2] - 0.5 * torch.tan(lat) * unit[:, 1]
    expected = 1e6 / distance + 1e6 / 6.38e6 * fallen
    torch.testing.assert_close(seen[0] - seen[1], expected, atol=3e-3, rtol=0.01)


def test_sample_by_sample_and_streaming(range_drive: Callable[..., Any]) -> None:
    d = range_drive(seconds=10, seed=2)
    options = pointed(d.options)
    exact, slow = run(d, options), run(d, options, "sequential")
    assert slow.method == "sequential"
    assert metres(exact, slow) < 5e-3
    ekf = TightEkf(RissVehicle(options), systems=2)
    belief = ekf.start(d.start, 8)
    whole = ekf(d.start, d.samples, d.ranges, d.timing, silence=torch.zeros(1).double())
    for k in range(10):
        stretch = RissSample(*(x[:, 20 * k : 20 * k + 20] for x in d.samples))
        belief = ekf.step(belief, stretch)
        belief = ekf.update(belief, SatelliteRanges(*(x[:, k] for x in d.ranges)), stretch)
        at = map_tight_belief(whole.belief, lambda x: x[:, k])  # noqa: B023
        assert_same(belief, at, atol=1e-7, rtol=1e-7)


def test_a_batch_is_its_drives_and_faults_are_refused(range_drive: Callable[..., Any]) -> None:
    d = range_drive(seconds=24, batch=3, seed=4)
    has, wild = d.ranges.has_range.clone(), d.ranges.pseudorange.clone()
    has[1, 5:15] = 0.0
    wild[1, 18:, 2] += 1e5
    # the clock jumps
    wild[2, 12:] += 3e5
    options = pointed(d.options)
    ranges = d.ranges._replace(has_range=has, pseudorange=wild)
    whole = run(d, options, has_range=has, pseudorange=wild)
    assert whole.resets.tolist() == [[0, 0], [0, 0], [0, 1]]
    assert bool((whole.verdict[1, 18:, 2] == Verdict.REFUSED_BY_GATE).all())
    linear = run(d, d.options, has_range=has, pseudorange=wild)
    assert torch.equal(whole.verdict, linear.verdict)
    assert float((whole.belief.clock - linear.belief.clock).abs()[..., 0].max()) < 0.2
    ekf = TightEkf(RissVehicle(options), systems=2)
    for b in range(3):
        with torch.no_grad():
            alone = ekf(
                map_tree(d.start, lambda x: x[b]),  # noqa: B023
                *(map_tree(part, lambda x: x[b]) for part in (d.samples, ranges, d.timing)),  # noqa: B023
            )
        member = map_tree(whole, lambda x: x[b])  # noqa: B023
        assert_same(alone.belief, member.belief, atol=1e-6, rtol=1e-6)
        assert torch.equal(alone.verdict, member.verdict)


def test_position_begins_anew(range_drive: Callable[..., Any]) -> None:
    """Ranges that agree on another place than the filter's, ten times in a row, are believed."""
    d = range_drive(seconds=40, seed=1)
    away = d._replace(
        start=d.start._replace(state=d.start.state._replace(lat=d.start.state.lat + 400.0 / 6.4e6))
    )
    options = pointed(replace(d.options, initial=replace(d.options.initial, position=1.0)))
    start = away.start._replace(covariance=0.04 * away.start.covariance)
    history = run(away._replace(start=start), options)
    assert int(history.resets[0, 0]) == 1
    truth = torch.stack(enu_between(*history.trajectory[:3], *d.truth[:3]))[:2, 0]
    assert float(truth[:, -1].norm()) < 5.0


def test_covariances_stay_positive(range_drive: Callable[..., Any]) -> None:
    d = range_drive(seconds=30, seed=5)
    has = d.ranges.has_range.clone()
    has[:, 10:20] = 0.0
    for alpha in (1.0, 1e-3):
        history = run(d, pointed(d.options, alpha), has_range=has)
        sigma = history.belief.covariance.diagonal(dim1=-2, dim2=-1).sqrt()
        scaled = history.belief.covariance / (sigma.unsqueeze(-1) * sigma.unsqueeze(-2))
        assert float(torch.linalg.eigvalsh(scaled).min()) > 0.0


def test_doors(range_drive: Callable[..., Any]) -> None:
    d = range_drive(seconds=3)
    with pytest.raises(ConfigError, match="choose feedback closed"):
        RissVehicle(pointed(EkfOptions(feedback="open")))
    with pytest.raises(LogError):
        run(d, pointed(d.options), pseudorange=d.ranges.pseudorange * torch.nan)


def test_gradients_flow(range_drive: Callable[..., Any]) -> None:
    d = range_drive(seconds=5, seed=6)
    ekf = TightEkf(RissVehicle(pointed(d.options)), systems=2)

    def loss(log_noise: Tensor) -> Tensor:
        history = torch.func.functional_call(
            ekf,
            {"vehicle.log_noise": log_noise},
            (d.start, d.samples, d.ranges, d.timing),
        )
        explained = history.innovation.square() / history.spread
        return explained.nansum() + history.trajectory.height[0, -1]

    at = ekf.vehicle.log_noise.detach().requires_grad_()
    (gradient,) = torch.autograd.grad(loss(at), at)
    assert bool(torch.isfinite(gradient).all())
    g = torch.Generator().manual_seed(0)
    way = torch.randn(at.shape, generator=g, dtype=torch.float64)
    with torch.no_grad():
        told = (loss(at + 1e-3 * way) - loss(at - 1e-3 * way)) / 2e-3
    # ranges of 2e7 m keep 4e-9 m of what differences are taken of
    assert float(told) == pytest.approx(float((gradient * way).sum()), rel=2e-3)
