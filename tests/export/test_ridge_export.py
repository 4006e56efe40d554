"""A ridge model written as a predictor equals eager, in both formats."""

from pathlib import Path

import pytest
import torch

from navlearn.error_models.base import (
    FittedErrorModel,
    TrainingCurves,
    TrainingRecord,
    TrainingSource,
)
from navlearn.error_models.gyro_terms import PHYSICAL_TERMS, product_terms
from navlearn.error_models.ridge import RidgeModel, RidgeOptions
from navlearn.export import export_predictor, load_predictor
from navlearn.export.reading import Kind

INPUTS = ("yaw_rate", "f_x", "f_y")


@pytest.mark.parametrize(("kind", "name"), [("torchscript", "r.pt"), ("torch_export", "r.pt2")])
def test_predictor_equals_eager(kind: Kind, name: str, tmp_path: Path) -> None:
    generator = torch.Generator().manual_seed(0)
    u = torch.randn(40, 3, generator=generator, dtype=torch.float64)
    model = RidgeModel(RidgeOptions(inputs=3, terms=PHYSICAL_TERMS))
    theta = torch.tensor([0.02, -0.01, 0.015, 1e-3, -2e-3], dtype=torch.float64)
    model.set_fit(product_terms(PHYSICAL_TERMS, INPUTS, 0.01), theta, torch.eye(5).double(), u)
    record = TrainingRecord(
        source=TrainingSource(acts_on="gyro_rate", inputs=INPUTS, outputs=("gyro_rate_error",)),
        time_span=(0.0, 4.0), samples=40, validation_samples=0, trainer="ridge", loop="open",
        iterations=1, stopped="closed form", seed=0, train_loss=1.0, valid_loss=1.0, versions=(),
    )  # fmt: skip
    fitted = FittedErrorModel(
        kind="ridge", model=model.eval(), options=model.options, record=record,
        curves=TrainingCurves(train=(1.0,), valid=()),
    )  # fmt: skip
    report = export_predictor(fitted, tmp_path / name, check_inputs=u, kind=kind)
    assert max(report.differences.values()) < 1e-14
    assert load_predictor(tmp_path / name).metadata.output_units == ("rad/s",)
