"""Coefficients of a finished search, and the model that they make.

The search works on sums; the coefficients come from the chosen columns themselves, by orthogonal
triangularisation, so that no precision is lost in squares.
"""

import platform
from typing import NamedTuple

import torch
from torch import Tensor

import navlearn
from navlearn.error_models.base import (
    FittedErrorModel,
    TrainingCurves,
    TrainingRecord,
    TrainingSource,
)
from navlearn.error_models.fos import FosModel
from navlearn.error_models.fos_candidates import Candidates, factor_list
from navlearn.error_models.fos_options import FosOptions
from navlearn.error_models.fos_state import Search
from navlearn.error_models.scaling import fit_scaling

LONGEST_RUN = 60


class Outcome(NamedTuple):
    """What a search of one window found.

    Attributes:
        chosen: Places of the terms in a table of candidates.
        coefficients: Original units, shape (k,).
        data_error: Weighted energy of the residual.
        errors: Energy of the residual with the ridge's after each step, the target's first.
        stopped: Why the search ended.
        effective: Rows that count, by their weights.
        weight: Sum of the weights.
        samples: Rows of positive weight.
    """

    chosen: list[int]
    coefficients: Tensor
    data_error: float
    errors: list[float]
    stopped: str
    effective: float
    weight: float
    samples: int


def read_outcomes(search: Search, candidates: Candidates, target: Tensor) -> list[Outcome]:
    """Return what the search of each window found.

    Args:
        search: Finished.
        candidates: What was searched.
        target: Shape (B, N).
    """
    root = candidates.weight.sqrt()
    slots = search.chosen.shape[1]
    used = search.used()
    chosen = candidates.columns(search.chosen) * root.unsqueeze(1) * used.unsqueeze(2)
    goal = torch.nn.functional.pad(root * target, [0, slots])
    ridge = search.options.ridge * (search.chosen != 0).double()
    # A place without a term gets a row of its own as well: orthogonal to all, coefficient zero.
    own = torch.where(used, (ridge * chosen.square().sum(2)).sqrt(), 1.0)
    basis, upper = torch.linalg.qr(torch.cat([chosen, torch.diag_embed(own)], 2).mT)
    theta = torch.linalg.solve_triangular(upper, basis.mT @ goal.unsqueeze(2), upper=True)
    theta = theta.squeeze(2)
    residual = goal[:, :-slots] - (theta.unsqueeze(2) * chosen).sum(1)
    data, samples = residual.square().sum(1).tolist(), (candidates.weight > 0).sum(1).tolist()
    return [
        Outcome(
            chosen=search.chosen[k, used[k]].tolist(),
            coefficients=theta[k, used[k]],
            data_error=data[k],
            errors=search.errors[k],
            stopped=search.stopped[k],
            effective=search.effective[k],
            weight=float(search.weight[k]),
            samples=samples[k],
        )
        for k in range(len(data))
    ]


def build_fitted(
    found: Outcome,
    u: Tensor,
    y: Tensor,
    weight: Tensor,
    options: FosOptions,
    source: TrainingSource,
) -> FittedErrorModel:
    """Return the model that a search found, with its record.

    Args:
        found: Result of the search over these rows.
        u: Inputs, shape (..., T, m).
        y: Target, shape (..., T, 1).
        weight: Shape (..., T).
        options: What was searched.
        source: What the caller knows about the data.
    """
    scaling = fit_scaling(u, weight), fit_scaling(y, weight)
    factors = factor_list(u.shape[-1], options)
    pairs = [divmod(place, len(factors)) for place in found.chosen]
    model = FosModel(u.shape[-1], tuple(factors[i] + factors[j] for i, j in pairs), options)
    model.set_fit(found.coefficients, *scaling)
    free = max(found.effective - len(pairs), 1.0)
    error = found.data_error / found.weight * found.effective / free
    model.set_variance(torch.full((1, 1), error, dtype=torch.float64))
    if model.feedback:
        model.set_variance(_free_run_variance(model, u.double(), y.double(), weight))
    energy = found.weight * float(scaling[1].scale) ** 2
    curve = tuple(value / energy for value in found.errors)
    return FittedErrorModel(
        kind="fos",
        model=model.eval(),
        options=options,
        record=_record(found, u.shape[:-1].numel(), source, curve[-1], options.seed),
        curves=TrainingCurves(train=curve, valid=()),
    )


def _free_run_variance(model: FosModel, u: Tensor, y: Tensor, weight: Tensor) -> Tensor:
    """Return the mean squared error of free runs over the record, by step, shape (H, 1)."""
    past, steps = model.memory, u.shape[-2]
    length = max(1, min(LONGEST_RUN, (steps - past) // 2))
    starts = range(past, steps - length + 1, length)
    cut_u, cut_y = (torch.stack([v[..., k - past : k + length, :] for k in starts]) for v in (u, y))
    share = torch.stack([weight[..., k : k + length] for k in starts])
    state = model.warm_state(cut_u[..., :past, :], cut_y[..., :past, :])
    runs = model.run(cut_u[..., past:, :], state)
    error = (runs - cut_y[..., past:, :])[..., 0].square()
    share = torch.where(torch.isfinite(error), share, 0.0)
    error = torch.where(share > 0, share * error, 0.0).reshape(-1, length).sum(0)
    count = share.reshape(-1, length).sum(0)
    return torch.where(count > 0, error / count, torch.inf).unsqueeze(1)


def _record(
    found: Outcome, rows: int, source: TrainingSource, loss: float, seed: int
) -> TrainingRecord:
    """Return what the model was trained on."""
    return TrainingRecord(
        source=source,
        time_span=(0.0, rows * source.time_step),
        samples=found.samples,
        validation_samples=0,
        trainer="fos",
        loop="open",
        iterations=len(found.errors) - 1,
        stopped=found.stopped,
        seed=seed,
        train_loss=loss,
        valid_loss=float("nan"),
        versions=(
            ("navlearn", navlearn.__version__),
            ("torch", str(torch.__version__)),
            ("python", platform.python_version()),
        ),
    )
