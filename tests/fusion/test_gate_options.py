"""What may be chosen about believing measurements, and what is refused at the door."""

import math

import pytest
import torch

from navlearn.errors import ConfigError
from navlearn.fusion.gate_options import GateOptions
from navlearn.fusion.measurements import Verdict, believed, refused
from navlearn.fusion.noise_options import InitialOptions
from navlearn.fusion.options import EkfOptions


@pytest.mark.parametrize(
    ("name", "value", "message"),
    [
        ("probability", 0.0, r"expected in \(0, 1\]"),
        ("probability", math.nan, r"expected in \(0, 1\]"),
        ("prediction_limit", 0.0, r"more than 0 m, or \.inf"),
        ("motion_limit", math.nan, r"more than 0 m, or \.inf"),
        ("motion_growth", -0.1, "finite value >= 0"),
        ("motion_reference", "gyro", "choose among odometer, none"),
        ("robust", "tukey", "choose among none, huber, student"),
        ("robust_limit", 0.0, "finite value > 0"),
        ("freedom", math.inf, "finite value > 0"),
        ("reset_after", -1, "finite value >= 0"),
        ("reset_azimuth", math.inf, "finite value >= 0"),
    ],
)
def test_a_gate_out_of_range_is_refused_where_it_is_made(name, value, message):
    with pytest.raises(ConfigError, match=f"GateOptions.{name}.*{message}"):
        GateOptions(**{name: value})


@pytest.mark.parametrize(
    ("entry", "value", "named"),
    [
        ("position", -1.0, "position"),
        ("azimuth", math.nan, "azimuth"),
        ("gyro", {"bias": -0.1}, "gyro.bias"),
        ("speed", {"scale": math.inf}, "speed.scale"),
    ],
)
def test_a_deviation_at_the_start_is_none_below_zero(entry, value, named):
    with pytest.raises(ConfigError, match=rf"InitialOptions\.{named}: found .* finite value >= 0"):
        EkfOptions(initial=InitialOptions(**{entry: value}))


def test_nothing_but_the_chi_square_gate_is_on_unless_asked_for():
    gate = GateOptions()
    assert not gate.tests_motion
    assert not gate.tests_position
    assert not gate.weighs
    assert GateOptions(prediction_limit=5.0).tests_position
    assert GateOptions(motion_limit=5.0).tests_motion
    assert GateOptions(robust="huber").weighs


def test_every_verdict_is_absent_believed_or_refused():
    codes = torch.tensor([int(v) for v in Verdict])
    names = [v.name for v in Verdict]
    assert [n for n, b in zip(names, believed(codes), strict=True) if b] == [
        n for n in names if n.startswith("ACCEPTED")
    ]
    assert [n for n, b in zip(names, refused(codes), strict=True) if b] == [
        n for n in names if n.startswith("REFUSED")
    ]
