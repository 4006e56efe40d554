import math

import torch

from navlearn.learning.quasi_newton import Point, first_inverse, quasi_newton_step


def _rosenbrock(x):
    leaf = x.detach().clone().requires_grad_(True)
    value = 100.0 * (leaf[1] - leaf[0] ** 2) ** 2 + (1.0 - leaf[0]) ** 2
    (slope,) = torch.autograd.grad(value, leaf)
    return Point(x, float(value.detach()), slope)


def _minimised(function, x, steps=200, longest=1.0):
    point = function(torch.tensor(x, dtype=torch.float64))
    inverse = first_inverse(point)
    for _ in range(steps):
        found = quasi_newton_step(function, point, inverse, longest)
        if found is None:
            break
        assert found[0].value < point.value
        assert float((found[0].x - point.x).abs().max()) <= longest + 1e-12
        point, inverse = found
    return point


def test_a_curved_valley_is_followed_to_its_end():
    found = _minimised(_rosenbrock, [-1.2, 1.0])
    assert torch.allclose(found.x, torch.ones(2, dtype=torch.float64), atol=1e-3)


def test_points_that_are_refused_are_stepped_back_from():
    def walled(x):
        point = _rosenbrock(x)
        lost = Point(x, math.inf, torch.zeros_like(x))
        return lost if float(x[0]) > 0.5 else point

    found = _minimised(walled, [-1.2, 1.0])
    assert 0.3 < float(found.x[0]) <= 0.5


def test_nothing_is_done_where_no_step_goes_downhill():
    point = _rosenbrock(torch.ones(2, dtype=torch.float64))
    assert quasi_newton_step(_rosenbrock, point, first_inverse(point), 1.0) is None
