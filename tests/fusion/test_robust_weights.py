"""Weights of far measurements: their closed forms, and what one weighted update does."""

import math

import numpy as np
import pytest
import torch
from scipy.optimize import minimize_scalar
from scipy.stats import chi2, norm

from navlearn.fusion.gate_options import GateOptions
from navlearn.fusion.gated_update import gated_update
from navlearn.fusion.measured import Measured
from navlearn.fusion.measurements import Kind, Rows, Verdict
from navlearn.fusion.robust import LESS, weights

ROWS = Rows((Kind.POSITION, Kind.COURSE), (0, 3), (3, 1))
HUBER, STUDENT = (GateOptions(robust=one, probability=1.0) for one in ("huber", "student"))
GATES = {"huber": HUBER, "student": STUDENT}


def weight_of(gate, nis, kind, verdict=Verdict.ACCEPTED):
    squares = torch.full((5,), math.nan, dtype=torch.float64)
    squares[kind] = nis
    said = torch.zeros(5, dtype=torch.int64)
    said[kind] = int(verdict)
    found = weights(gate, ROWS, squares, said)
    others = [k for k in range(5) if k != kind]
    assert found[others].tolist() == [1.0] * 4
    return float(found[kind])


@pytest.mark.parametrize(("kind", "rows"), [(Kind.POSITION, 3), (Kind.COURSE, 1)])
def test_huber_touches_the_same_share_of_good_measurements_of_every_kind(kind, rows):
    share = 2.0 * norm.cdf(1.345) - 1.0
    knee = chi2.ppf(share, rows)
    assert weight_of(HUBER, 0.999 * knee, kind) == 1.0
    for nis in (1.01 * knee, 9.0 * knee, 1e6):
        assert weight_of(HUBER, nis, kind) == pytest.approx(math.sqrt(knee / nis), rel=1e-9)
    assert knee == pytest.approx(1.345**2, rel=1e-9) if rows == 1 else knee > 1.345**2


@pytest.mark.parametrize(("kind", "rows"), [(Kind.POSITION, 3), (Kind.COURSE, 1)])
def test_student_has_its_weights_from_the_density_but_never_above_one(kind, rows):
    for nis in (0.0, 0.5 * rows, rows):
        assert weight_of(STUDENT, nis, kind) == 1.0
    for nis in (2.0 * rows, 50.0, 1e6):
        step = 1e-4 * nis
        # -2 d log p / d NIS of the multivariate density with four degrees of freedom
        log = [-0.5 * (4.0 + rows) * math.log(1.0 + (nis + s) / 4.0) for s in (-step, step)]
        slope = -2.0 * (log[1] - log[0]) / (2.0 * step)
        assert weight_of(STUDENT, nis, kind) == pytest.approx(slope, rel=1e-6)


@pytest.mark.parametrize("gate", [HUBER, STUDENT])
def test_what_is_refused_absent_or_taken_by_a_reset_has_no_weight_but_one(gate):
    for verdict in Verdict:
        weighs = verdict in (Verdict.ACCEPTED, Verdict.ACCEPTED_WITH_LESS_WEIGHT)
        assert (weight_of(gate, 1e4, Kind.POSITION, verdict) < 0.1) == weighs


def linear(innovation, prior=1.0, noise=2.0):
    """One state, one measurement of it: a filter, its covariance, what is measured."""
    given = torch.tensor([float(innovation)], dtype=torch.float64)
    H = torch.ones(1, 1, dtype=torch.float64)
    present = torch.zeros(5, dtype=torch.float64)
    present[Kind.COURSE] = 1.0
    return prior**2 * H, Measured(given, H, noise**2 * torch.ones(1).double(), present)


class OneRow:
    """A gate of one kind of one row."""

    rows = Rows((Kind.COURSE,), (0,), (1,))
    anchor, company = None, ()

    def __init__(self, gate):
        self.gate = gate
        self.limits = (math.inf if gate.probability == 1.0 else chi2.ppf(gate.probability, 1),)


def update(gate, innovation, **sizes):
    P, found = linear(innovation, **sizes)
    refused = torch.zeros(5, dtype=torch.float64)
    return gated_update(OneRow(gate), P, refused, found, lambda v: torch.zeros(1).double())


@pytest.mark.parametrize("name", GATES)
def test_a_weighted_update_is_a_kalman_update_with_a_larger_variance(name):
    for innovation in (0.3, 4.0, -25.0):
        new, said = update(GATES[name], innovation)
        nis = innovation**2 / 5.0
        weight = min(1.0, 1.345 / math.sqrt(nis) if name == "huber" else 5.0 / (4.0 + nis))
        gain = 1.0 / (1.0 + 4.0 / weight)
        assert float(new.correction) == pytest.approx(gain * innovation, rel=1e-9)
        assert float(new.covariance) == pytest.approx(1.0 - gain, rel=1e-9)
        less = int(said.verdict[Kind.COURSE]) == Verdict.ACCEPTED_WITH_LESS_WEIGHT
        assert less == (weight < LESS)


def cost(name, x, innovation, prior, noise):
    e2 = ((innovation - x) / noise) ** 2
    if name == "student":
        far = 2.5 * np.log1p(e2 / 4.0)
    else:
        e = math.sqrt(e2)
        far = 0.5 * e2 if e <= 1.345 else 1.345 * e - 0.5 * 1.345**2
    return 0.5 * (x / prior) ** 2 + far


@pytest.mark.parametrize("name", GATES)
def test_where_the_prediction_is_sure_one_step_hardly_differs_from_the_minimum_of_the_cost(name):
    prior, noise = 0.5, 3.0
    for innovation in (10.0, 20.0, 60.0):
        found = minimize_scalar(
            lambda x, z=innovation: cost(name, x, z, prior, noise),
            bounds=(-0.5 * innovation, 0.5 * innovation),
            method="bounded",
            options={"xatol": 1e-10},
        )
        step = float(update(GATES[name], innovation, prior=prior, noise=noise)[0].correction)
        plain = innovation * prior**2 / (prior**2 + noise**2)
        assert abs(step - found.x) < 0.05 * prior
        assert abs(step) < 0.6 * plain


def test_an_outlier_moves_huber_by_a_bounded_way_and_student_not_at_all():
    far = [float(update(HUBER, z)[0].correction) for z in (1e2, 1e4, 1e6)]
    bound = 1.345 * 1.0**2 * math.sqrt(5.0) / 2.0**2
    assert far == sorted(far)
    assert far[-1] == pytest.approx(bound, rel=1e-4)
    assert far[-1] < bound
    gone = [float(update(STUDENT, z)[0].correction) for z in (1e2, 1e4, 1e6)]
    assert gone == sorted(gone, reverse=True)
    assert gone[-1] < 1e-5


@pytest.mark.parametrize("name", GATES)
def test_a_gate_at_a_far_limit_refuses_and_weights_are_inside_it(name):
    gate = GateOptions(robust=name, probability=1.0 - 1e-9)
    limit = chi2.ppf(1.0 - 1e-9, 1)
    for nis, verdict in (
        (0.1, Verdict.ACCEPTED),
        (0.9 * limit, Verdict.ACCEPTED_WITH_LESS_WEIGHT),
        (1.1 * limit, Verdict.REFUSED_BY_GATE),
    ):
        assert int(update(gate, math.sqrt(5.0 * nis))[1].verdict[Kind.COURSE]) == verdict


@pytest.mark.parametrize("name", GATES)
def test_gradients_flow_through_weights(name):
    def moved(innovation, variance, prior):
        P, found = linear(0.0)
        found = found._replace(innovation=innovation, variance=variance)
        refused = torch.zeros(5, dtype=torch.float64)
        new, _ = gated_update(OneRow(GATES[name]), P * prior, refused, found, lambda v: prior)
        return new.correction, new.covariance

    leaves = [torch.tensor([v], dtype=torch.float64, requires_grad=True) for v in (9.0, 4.0, 1.0)]
    assert torch.autograd.gradcheck(moved, leaves)
