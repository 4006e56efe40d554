"""A range known less well counts for less, whether the receiver tells of its noise or not."""

import pytest
import torch

from navlearn.errors import ConfigError
from navlearn.experiment.range_error_correction import told_wider
from navlearn.gnss.range_noise import RangeNoiseOptions, range_noise, range_variance
from navlearn.states import SatelliteRanges


@pytest.mark.parametrize("told", [0.0, 0.4])
@pytest.mark.parametrize("factor", [1.0, 2.0])
def test_what_is_added_is_what_was_asked_for(told: float, factor: float) -> None:
    options = RangeNoiseOptions(told_factor=factor)
    cn0 = torch.tensor([[22.0, 30.0, 45.0, 52.0]], dtype=torch.float64)
    one = torch.ones_like(cn0)
    vector = one.unsqueeze(-1).expand(*one.shape, 3)
    ranges = SatelliteRanges(
        vector, vector, one, one, 0.5 * one, cn0, told * one, one, one.long(), one, one
    )

    def variance(std: torch.Tensor) -> torch.Tensor:
        return range_variance(range_noise(options), ranges.elevation, cn0, std)

    further = variance(told_wider(ranges, options, 3.0)) - variance(ranges.std_range)
    torch.testing.assert_close(further, 9.0 * one)
    with pytest.raises(ConfigError, match="told_factor"):
        told_wider(ranges, RangeNoiseOptions(told_factor=0.0), 3.0)
