"""The unscented filter stands behind the same thresholds and weights as the extended one."""

from dataclasses import replace

import pytest
import torch

from navlearn.filters.unscented import UnscentedOptions
from navlearn.frames import enu_between, shift_geodetic
from navlearn.fusion.error_state import initial_belief
from navlearn.fusion.filters_of import riss_filter
from navlearn.fusion.gate_options import GateOptions
from navlearn.fusion.measurements import Kind, Verdict
from navlearn.fusion.options import EkfOptions

pytestmark = pytest.mark.filterwarnings("ignore:filter. :UserWarning")
GATES = {
    "thresholds": GateOptions(prediction_limit=12.0, motion_limit=6.0, reset_after=4),
    "motion": GateOptions(motion_limit=6.0, probability=1.0, reset_after=4),
    "huber": GateOptions(robust="huber", probability=1.0),
    "student": GateOptions(robust="student", probability=1.0 - 1e-9),
}


def run(options, d, method="exact"):
    with torch.no_grad():
        belief = initial_belief(options, d.start)
        return riss_filter(options)(belief, d.samples, d.fixes, d.timing, method=method)


def apart(a, b):
    return max(float(x.abs().max()) for x in enu_between(*a[:3], *b[:3]))


@pytest.mark.parametrize("name", GATES)
def test_it_believes_what_the_extended_one_does_and_all_at_once_what_the_loop_does(
    make_drive, name
):
    d = make_drive(seconds=40, rate=10)
    east, north = torch.zeros_like(d.fixes.lat), torch.zeros_like(d.fixes.lat)
    east[:, 12], north[:, 20:27] = 40.0, 25.0
    lat, lon, height = shift_geodetic(*d.fixes[:3], east, north, 0.0 * east)
    d = d._replace(fixes=d.fixes._replace(lat=lat, lon=lon, height=height))
    options = EkfOptions(gate=GATES[name])
    extended = run(options, d)
    points = replace(options, unscented=UnscentedOptions())
    exact, fast = (run(points, d, m) for m in ("exact", "fast"))
    assert fast.method == "fast"
    said = extended.verdict[0, :, Kind.POSITION]
    assert int((said != int(Verdict.ACCEPTED)).sum()) > 2
    # small noise: verdicts may differ where a figure lies on a limit, and hardly anywhere else
    assert int((exact.verdict != extended.verdict).sum()) <= 1
    assert torch.equal(fast.verdict, exact.verdict)
    assert apart(fast.trajectory, exact.trajectory) < 5e-3
    assert apart(exact.trajectory, extended.trajectory) < 1.0
