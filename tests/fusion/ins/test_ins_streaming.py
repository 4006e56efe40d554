"""The scripted prediction against the filter's own step."""

import pytest
import torch

from navlearn.fusion.ins.loosely_coupled import InsEkf
from navlearn.fusion.ins.options import InsEkfOptions
from navlearn.fusion.ins.start import initial_ins_belief
from navlearn.fusion.ins.streaming import InsPredictor
from navlearn.states import ImuSample, InsState

CHOICES = {
    "default": {},
    "scale": {"states": 21},
    "dahmane2022": {"states": 9, "model": "dahmane2022", "odometer": False},
    "gauss_markov": {"correlation_time": 300.0},
}


def last(samples, k):
    return ImuSample(*(x[k] for x in samples))


@pytest.mark.parametrize("name", CHOICES)
def test_scripted_prediction_is_the_step(make_drive, name):
    d = make_drive(seconds=8, rate=25)
    options = InsEkfOptions(**CHOICES[name])
    known = {"gyro_bias": 0.01, "accel_bias": 0.1, "gyro_scale": 0.01, "accel_scale": -0.01}
    start = InsState(*(x[150] for x in d.truth))
    belief = initial_ins_belief(options, start, sensor=known)
    scripted, ekf = torch.jit.script(InsPredictor(options)), InsEkf(options)
    one, other = belief, belief
    with torch.no_grad():
        for k in range(151, 157):
            one = scripted(one, last(d.samples, k))
            other = ekf.step(other, last(d.samples, k))
    for a, b in zip((*one.state, *one[1:]), (*other.state, *other[1:]), strict=True):
        torch.testing.assert_close(a, b, rtol=1e-11, atol=1e-13)
    assert float((one.covariance - belief.covariance).abs().max()) > 0.0


def test_scripted_prediction_takes_batches(make_drive):
    d = make_drive(seconds=8, rate=25)
    options = InsEkfOptions()
    start = InsState(*(x[150:153] for x in d.truth))
    belief = initial_ins_belief(options, start)
    scripted = torch.jit.script(InsPredictor(options))
    together = scripted(belief, ImuSample(*(x[151:154] for x in d.samples)))
    for b in range(3):
        alone = scripted(
            initial_ins_belief(options, InsState(*(x[b] for x in start))), last(d.samples, 151 + b)
        )
        torch.testing.assert_close(together.covariance[b], alone.covariance, rtol=1e-11, atol=0.0)
        torch.testing.assert_close(together.state.v_l[b], alone.state.v_l, rtol=0.0, atol=1e-12)
