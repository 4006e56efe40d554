"""Fitted models, the network never trained, and inputs for them: exports ask for no more."""

from collections.abc import Callable
from dataclasses import replace

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
from navlearn.error_models.fos_fit import fit_fos
from navlearn.error_models.fos_options import FosOptions
from navlearn.error_models.gyro_terms import product_terms
from navlearn.error_models.pci import PciOptions
from navlearn.error_models.pci_fit import fit_pci
from navlearn.error_models.ridge import RidgeModel, RidgeOptions
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


def gyro_source() -> TrainingSource:
    return replace(SOURCE, acts_on="gyro_rate", outputs=("yaw_rate_error",))


def fitted_fos(lags: int, source: TrainingSource, output_lags: int = 0) -> FittedErrorModel:
    u, y = gyro_error(lags)
    options = FosOptions(lags=lags, output_lags=output_lags, max_terms=5)
    return fit_fos(u, y, options=options, source=source)


def fitted_pci(lags: int, source: TrainingSource) -> FittedErrorModel:
    u, y = gyro_error(lags)
    return fit_pci(u, y, PciOptions(inputs=3, lags=lags, cascades=4), source=source)


def fitted_ridge(source: TrainingSource) -> FittedErrorModel:
    u, _ = gyro_error(1)
    terms = product_terms(("yaw_rate", "abs_yaw_rate", "yaw_rate*speed"), SOURCE.inputs, 0.01)
    model = RidgeModel(RidgeOptions(inputs=3, terms=terms.names))
    size = torch.tensor([0.02, -0.01, 1e-3], dtype=torch.float64)
    model.set_fit(terms, size, torch.diag(0.01 * size.square()), u)
    fitted = fitted_model(source=source)
    return replace(fitted, kind="ridge", model=model.eval(), options=model.options)


def gyro_error(lags: int) -> tuple[Tensor, Tensor]:
    """A slightly nonlinear error of a gyro that remembers."""
    u = some_inputs(400, seed=5)
    rate = u[:, :1] + 0.5 * u[:, :1].roll(lags, 0)
    noise = torch.randn(400, 1, generator=torch.Generator().manual_seed(6), dtype=torch.float64)
    return u, 0.01 + 0.03 * rate + 0.5 * rate**2 + 1e-4 * u[:, 1:2] + 1e-3 * noise


def fitted_model(
    *, lags: int = 2, source: TrainingSource | None = None, kind: str = "anarx"
) -> FittedErrorModel:
    if kind == "ridge":
        return fitted_ridge(source or gyro_source())
    if kind == "pci":
        return fitted_pci(lags, source or gyro_source())
    if kind.startswith("fos"):
        return fitted_fos(lags, source or gyro_source(), output_lags=int(kind == "fos fed back"))
    source = SOURCE if source is None else source
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
