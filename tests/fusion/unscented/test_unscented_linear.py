"""On a linear system the unscented filter is the Kalman filter, for wide points and narrow ones."""

from typing import Any, NamedTuple

import numpy as np
import pytest
import torch
from torch import Tensor

from navlearn.filters.belief import Belief
from navlearn.filters.unscented import UnscentedOptions, sigma_weights
from navlearn.fusion.gate_options import GateOptions
from navlearn.fusion.measured import Measured
from navlearn.fusion.measurements import Kind, Rows
from navlearn.fusion.tight.vehicle import VehicleAhead
from navlearn.fusion.unscented.recursion import run_unscented_loop
from navlearn.states import NavState

N, R, SAMPLES, STEPS = 6, 4, 3, 40


class LinearBlock(NamedTuple):
    """F (..., samples, n, n), Q, push (..., samples, n); H (..., r, n), variance, told (..., r)."""

    F: Tensor
    Q: Tensor
    push: Tensor
    H: Tensor
    variance: Tensor
    told: Tensor
    there: Tensor


class Linear:
    """x' = F x + push + noise in several samples a block; position and course are measured."""

    names = tuple("abcdef")
    rows = Rows((Kind.POSITION, Kind.COURSE), (0, 3), (3, 1))
    limits = (float("inf"), float("inf"))
    gate = GateOptions()
    anchor = None
    company = ()
    angle_rows = ()

    def all_blocks(self, line: LinearBlock) -> LinearBlock:
        return line

    def _through(self, x: Tensor, block: LinearBlock) -> Tensor:
        for F, push in zip(block.F.unbind(-3), block.push.unbind(-2), strict=True):
            x = (F @ x.unsqueeze(-1)).squeeze(-1) + push
        return x

    def predicted(self, belief: Belief, block: LinearBlock) -> VehicleAhead:
        whole = torch.eye(N, dtype=torch.float64).expand_as(belief.covariance)
        noise = torch.zeros_like(belief.covariance)
        for F, Q in zip(block.F.unbind(-3), block.Q.unbind(-3), strict=True):
            whole, noise = F @ whole, F @ noise @ F.transpose(-1, -2) + Q
        end = belief._replace(sensor=self._through(belief.sensor, block))
        return VehicleAhead(end, whole, noise)

    predicted_in_turn = predicted

    def carried(self, belief: Belief, block: LinearBlock) -> Belief:
        return belief._replace(sensor=self._through(belief.sensor, block))

    def carried_apart(self, belief: Belief, deviation: Tensor, block: LinearBlock) -> Tensor:
        for F in block.F.unbind(-3):
            deviation = deviation @ F.transpose(-1, -2)
        return deviation

    def in_samples(self, block: LinearBlock) -> list[LinearBlock]:
        return [
            block._replace(F=F.unsqueeze(-3), Q=Q.unsqueeze(-3), push=push.unsqueeze(-2))
            for F, Q, push in zip(
                block.F.unbind(-3), block.Q.unbind(-3), block.push.unbind(-2), strict=True
            )
        ]

    def moved(self, belief: Belief, correction: Tensor, block: Any) -> Belief:
        return belief._replace(sensor=belief.sensor + correction)

    moved_at_start = moved

    def difference(self, belief: Belief, other: Belief, block: Any) -> Tensor:
        return belief.sensor - other.sensor

    def measured(self, belief: Belief, block: LinearBlock) -> Measured:
        there = block.there.expand(*belief.sensor.shape[:-1], len(Kind))
        keep = self.rows.spread(there) > 0.5
        left = block.told - (block.H @ belief.sensor.unsqueeze(-1)).squeeze(-1)
        return Measured(
            torch.where(keep, left, 0.0),
            torch.where(keep.unsqueeze(-1), block.H, 0.0),
            torch.where(keep, block.variance, 1.0),
            there,
        )


def system(seed: int, batch: int) -> tuple[Belief, LinearBlock]:
    g = torch.Generator().manual_seed(seed)

    def draw(*shape: int) -> Tensor:
        return torch.randn(batch, STEPS, *shape, generator=g, dtype=torch.float64)

    noise, root = 0.2 * draw(SAMPLES, N, N), torch.randn(N, N, generator=g, dtype=torch.float64)
    there = torch.zeros(batch, STEPS, len(Kind), dtype=torch.float64)
    there[..., Kind.POSITION] = (draw() > -0.5).double()
    there[..., Kind.COURSE] = (draw() > 0.0).double()
    F = torch.eye(N, dtype=torch.float64) + 0.1 * draw(SAMPLES, N, N)
    blocks = LinearBlock(
        F, noise @ noise.mT, draw(SAMPLES, N), draw(R, N), 0.1 + draw(R).abs(), draw(R), there
    )
    none = torch.zeros(batch, dtype=torch.float64)
    mean = torch.randn(batch, N, generator=g, dtype=torch.float64)
    P = (root @ root.T).expand(batch, N, N)
    refused = torch.zeros(batch, len(Kind), dtype=torch.float64)
    return Belief(NavState(*[none] * 4), mean, torch.zeros(batch, 3), P, mean, refused), blocks


def kalman(start: Belief, blocks: LinearBlock, row: int) -> tuple[list[Any], list[Any]]:
    x, P = start.sensor[row].numpy(), start.covariance[row].numpy()
    means, spreads = [], []
    F, Q, push, H, variance, told, there = (leaf[row].numpy() for leaf in blocks)
    for k in range(STEPS):
        for j in range(SAMPLES):
            x, P = F[k, j] @ x + push[k, j], F[k, j] @ P @ F[k, j].T + Q[k, j]
        use = np.array([there[k, Kind.POSITION]] * 3 + [there[k, Kind.COURSE]]) > 0.5
        C, y = H[k][use], told[k][use]
        K = P @ C.T @ np.linalg.inv(C @ P @ C.T + np.diag(variance[k][use]))
        x, P = x + K @ (y - C @ x), (np.eye(N) - K @ C) @ P
        means.append(x)
        spreads.append(P)
    return means, spreads


@pytest.mark.parametrize("in_turn", [False, True])
@pytest.mark.parametrize(("alpha", "close"), [(1.0, 1e-11), (0.5, 1e-11), (1e-3, 1e-7)])
def test_it_is_the_linear_kalman_filter(alpha, close, in_turn):
    """Narrow points keep less of a double: differences of 1e-3 of a state's size, divided by it,
    and the even half divided by its square."""
    start, blocks = system(0, 2)
    weights = sigma_weights(UnscentedOptions(alpha=alpha), N)
    record = run_unscented_loop(Linear(), weights, start, blocks, in_turn=in_turn)
    for row in range(2):
        means, spreads = kalman(start, blocks, row)
        found = record.belief.sensor[row].numpy(), record.belief.covariance[row].numpy()
        np.testing.assert_allclose(found[0], means, rtol=0.0, atol=close)
        np.testing.assert_allclose(found[1], spreads, rtol=0.0, atol=close)


def test_it_is_the_linear_kalman_filter_where_a_state_is_known():
    """A variance of zero: the point stays where it is, and is told by nothing."""
    start, blocks = system(3, 1)
    P = start.covariance.clone()
    P[:, 2], P[:, :, 2] = 0.0, 0.0
    noise = blocks.Q.clone()
    noise[..., 2, :], noise[..., :, 2] = 0.0, 0.0
    F = blocks.F.clone()
    F[..., 2, :] = torch.eye(N, dtype=torch.float64)[2]
    start, blocks = start._replace(covariance=P), blocks._replace(Q=noise, F=F)
    weights = sigma_weights(UnscentedOptions(), N)
    record = run_unscented_loop(Linear(), weights, start, blocks)
    means, spreads = kalman(start, blocks, 0)
    np.testing.assert_allclose(record.belief.sensor[0].numpy(), means, rtol=0.0, atol=1e-10)
    np.testing.assert_allclose(record.belief.covariance[0].numpy(), spreads, rtol=0.0, atol=1e-10)
    assert float(record.belief.covariance[..., 2, :].abs().max()) == 0.0
