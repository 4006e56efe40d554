"""A tight filter that takes fixes along judges and weighs them as the loose one does."""

from typing import Any

import pytest
import torch
from torch import Tensor

from navlearn.frames import enu_between, shift_geodetic
from navlearn.fusion.error_state import initial_belief
from navlearn.fusion.gate_options import GateOptions
from navlearn.fusion.loosely_coupled import LooselyCoupledEkf
from navlearn.fusion.measurements import Kind, Verdict
from navlearn.fusion.options import EkfOptions
from navlearn.fusion.tight.module import TightEkf
from navlearn.fusion.tight.riss_vehicle import RissVehicle
from navlearn.states import SatelliteRanges

pytestmark = pytest.mark.filterwarnings("ignore:.*filter:UserWarning")
GATES = {
    "thresholds": GateOptions(prediction_limit=12.0, motion_limit=6.0, reset_after=4),
    "motion": GateOptions(motion_limit=6.0, probability=1.0, reset_after=4),
    "huber": GateOptions(robust="huber", probability=1.0),
    "all": GateOptions(robust="student", prediction_limit=30.0, motion_limit=15.0, reset_after=5),
}


def nothing(shape: tuple[int, ...]) -> SatelliteRanges:
    nan = torch.full((*shape, 3), torch.nan, dtype=torch.float64)
    vector = nan.unsqueeze(-1).expand(*nan.shape, 3)
    none, system = torch.zeros_like(nan), torch.zeros(nan.shape, dtype=torch.int64)
    return SatelliteRanges(vector, vector, nan, nan, nan, nan, nan, nan, system, none, none)


def spoiled(fixes: Any) -> Any:
    east, north = torch.zeros_like(fixes.lat), torch.zeros_like(fixes.lat)
    east[:, 12], north[:, 20:27] = 40.0, 25.0
    lat, lon, height = shift_geodetic(*fixes[:3], east, north, 0.0 * east)
    return fixes._replace(lat=lat, lon=lon, height=height)


def apart(a: Any, b: Any) -> float:
    return max(float(x.detach().abs().max()) for x in enu_between(*a[:3], *b[:3]))


@pytest.mark.parametrize("name", GATES)
def test_without_satellites_it_is_the_loose_filter(make_drive: Any, name: str) -> None:
    d = make_drive(seconds=40, rate=10, batch=2)
    options = EkfOptions(gate=GATES[name])
    start, fixes = initial_belief(options, d.start), spoiled(d.fixes)
    with torch.no_grad():
        loose = LooselyCoupledEkf(options)(start, d.samples, fixes, d.timing)
        ranges = nothing(tuple(d.fixes.lat.shape))
        tight = TightEkf(RissVehicle(options))(start, d.samples, ranges, d.timing, fixes=fixes)
    assert torch.equal(tight.own_verdict, loose.verdict)
    assert bool((loose.verdict > int(Verdict.ACCEPTED)).any())
    assert apart(tight.trajectory, loose.trajectory) < 1e-6


@pytest.mark.parametrize("name", GATES)
def test_beside_satellites_all_forms_believe_the_same(
    make_drive: Any, range_drive: Any, name: str
) -> None:
    d, sky = make_drive(seconds=40, batch=2), range_drive(seconds=40, batch=2)
    options = EkfOptions(gate=GATES[name])
    start, fixes = initial_belief(options, d.start), spoiled(d.fixes)
    ekf = TightEkf(RissVehicle(options), systems=2)
    with torch.no_grad():
        exact, fast, turn = (
            ekf(start, d.samples, sky.ranges, d.timing, fixes=fixes, method=m)
            for m in ("exact", "fast", "sequential")
        )
    assert fast.method == "fast"
    said = exact.own_verdict[:, :, Kind.POSITION][:, [12, 20]]
    assert bool((said != int(Verdict.ACCEPTED)).all())
    for other in (fast, turn):
        assert torch.equal(other.own_verdict, exact.own_verdict)
        assert torch.equal(other.verdict, exact.verdict)
        assert apart(other.trajectory, exact.trajectory) < 5e-3


def test_at_once_the_gradient_is_that_of_the_loop(make_drive: Any, range_drive: Any) -> None:
    d, sky = make_drive(seconds=25), range_drive(seconds=25)
    options = EkfOptions(gate=GATES["huber"])
    start, fixes = initial_belief(options, d.start), spoiled(d.fixes)
    found: dict[str, Tensor] = {}
    for method in ("exact", "fast"):
        ekf = TightEkf(RissVehicle(options), systems=2)
        noise = ekf.vehicle.log_noise
        noise.requires_grad_(True)
        run = ekf(start, d.samples, sky.ranges, d.timing, fixes=fixes, method=method)
        assert run.method == method
        state = run.belief.vehicle.state
        east, north, _ = enu_between(*state[:3], *(x[:, :1] for x in d.truth[:3]))
        (found[method],) = torch.autograd.grad((east - north).square().mean(), noise)
    size = found["exact"].abs().max()
    assert float((found["fast"] - found["exact"]).abs().max() / size) < 1e-2
