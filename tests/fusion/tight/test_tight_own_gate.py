"""What a vehicle measures of itself beside ranges: the gate at once is the gate block by block."""

import pytest
import torch

from navlearn.fusion.gating import judged
from navlearn.fusion.gating_over_time import judged_over_time
from navlearn.fusion.ins.options import InsEkfOptions
from navlearn.fusion.measurements import Verdict
from navlearn.fusion.tight.ins_vehicle import InsVehicle


@pytest.mark.parametrize("seed", range(4))
def test_vouched_and_unheard_kinds_over_time(seed: int) -> None:
    g = torch.Generator().manual_seed(seed)
    vehicle = InsVehicle(InsEkfOptions())
    kinds, batch, count = vehicle.rows.known, 5, 60

    def drawn(*shape: int) -> torch.Tensor:
        return torch.rand(*shape, generator=g, dtype=torch.float64)

    present = (drawn(batch, count, kinds) < 0.8).double()
    nis = torch.where(drawn(batch, count, kinds) < drawn(batch, 1, kinds), 1e4, 0.1)
    vouched, unheard = drawn(batch, count) < drawn(batch, 1), drawn(batch, count, kinds) < 0.1
    unheard = unheard & (present > 0.5)
    refused = torch.floor(14.0 * drawn(batch, kinds))
    fast = judged_over_time(vehicle, nis, present, refused, vouched=vouched, unheard=unheard)
    most = vehicle.gate.reset_after - 1
    for k in range(count):
        held = torch.where(vouched[:, k, None], refused.clamp(max=most), refused)
        said = judged(vehicle, nis[:, k], present[:, k], held)
        verdict = torch.where(unheard[:, k], int(Verdict.REFUSED_BY_GATE), said.verdict)
        refused = torch.where(unheard[:, k], held, said.refused)
        assert torch.equal(fast.verdict[:, k], verdict)
        assert torch.equal(fast.refused[:, k], refused)
    assert bool((fast.verdict == Verdict.ACCEPTED_BY_RESET).any())
