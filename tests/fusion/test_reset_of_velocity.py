"""The gate's reset where the filter has velocity states and fixes tell no vertical velocity."""

import pytest

from navlearn.fusion.error_state import initial_belief
from navlearn.fusion.gate_options import GateOptions
from navlearn.fusion.loosely_coupled import LooselyCoupledEkf
from navlearn.fusion.measurements import Kind
from navlearn.fusion.options import EkfOptions


@pytest.mark.filterwarnings("ignore:filter. :UserWarning")
@pytest.mark.parametrize("vertical", [True, False])
def test_velocity_is_believed_again_after_a_reset(make_drive, vertical):
    d = make_drive(seconds=60)
    v_e = d.fixes.v_e.clone()
    v_e[0, 20:] += 15.0  # from here on the receiver disagrees with all that was known
    options = EkfOptions(
        model="shen2010_full",
        position=False,
        vertical_velocity=vertical,
        gate=GateOptions(reset_after=5),
    )
    history = LooselyCoupledEkf(options)(
        initial_belief(options, d.start),
        d.samples,
        d.fixes._replace(v_e=v_e),
        d.timing,
        method="exact",
    )
    assert int(history.resets[0, Kind.VELOCITY]) >= 1
    after = history.nis[0, -20:, Kind.VELOCITY].nanmedian()
    assert float(after) < 20.0
