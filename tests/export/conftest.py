"""A fitted model that was never trained, and inputs for it: exports ask for no more."""

from collections.abc import Callable

import pytest
import torch
from torch import Tensor

from navlearn.error_models.anarx import Anarx, AnarxOptions
from navlearn.error_models.base import (
    FittedErrorModel,
    TrainingCurves,
    TrainingRecord,
    TrainingSource,
)
from navlearn.error_models.scaling import fit_scaling

SOURCE = TrainingSource(
    logs=("drive",),
    inputs=("yaw_rate", "speed", "delay"),
    outputs=("along", "cross"),
    time_step=1.0,
)


def some_inputs(rows: int = 60, seed: int = 1) -> Tensor:
    generator = torch.Generator().manual_seed(seed)
    noise = torch.randn(rows, 3, generator=generator, dtype=torch.float64)
    return noise * torch.tensor([0.1, 4.0, 0.3]) + torch.tensor([0.0, 12.0, 0.5])


def fitted_model(*, lags: int = 2, source: TrainingSource = SOURCE) -> FittedErrorModel:
    options = AnarxOptions(inputs=3, outputs=2, lags=lags, hidden=4)
    model = Anarx(options)
    generator = torch.Generator().manual_seed(3)
    with torch.no_grad():
        for weights in model.parameters():
            weights.copy_(0.3 * torch.randn(weights.shape, generator=generator))
    u = some_inputs(seed=2)
    y = 5.0 * torch.randn(60, 2, generator=generator, dtype=torch.float64)
    model.set_scaling(fit_scaling(u, torch.ones(60)), fit_scaling(y, torch.ones(60)))
    model.set_variance(torch.linspace(1.0, 9.0, 10, dtype=torch.float64)[:, None].repeat(1, 2))
    record = TrainingRecord(
        source=source,
        time_span=(600.0, 1200.0),
        samples=500,
        validation_samples=0,
        trainer="lm",
        loop="closed",
        iterations=20,
        stopped="converged",
        seed=4,
        train_loss=0.5,
        valid_loss=float("nan"),
        versions=(("navlearn", "0.1.0"), ("torch", "2.6")),
    )
    return FittedErrorModel(
        kind="anarx",
        model=model.eval(),
        options=options,
        record=record,
        curves=TrainingCurves(train=(1.0, 0.5), valid=()),
    )


@pytest.fixture
def make_inputs() -> Callable[..., Tensor]:
    return some_inputs


@pytest.fixture
def make_fitted() -> Callable[..., FittedErrorModel]:
    return fitted_model
