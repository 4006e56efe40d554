"""Exported predictors: equal to eager, whole or not there, and telling what they are."""

import json
import subprocess
import sys
from collections.abc import Callable
from dataclasses import replace
from inspect import signature
from pathlib import Path
from typing import Any

import pytest
import torch
from torch import Tensor

from navlearn.error_models.anarx import Anarx
from navlearn.error_models.base import (
    ACTS_ON,
    OUTPUT_UNITS,
    FittedErrorModel,
    TrainingSource,
)
from navlearn.error_models.regressors import CHANNELS, build_regressors
from navlearn.errors import ConfigError, FitError, LogNotFoundError, OutputExistsError, ShapeError
from navlearn.export import PredictorMetadata, describe, export_predictor, load_predictor
from navlearn.export.example import load_example, save_example
from navlearn.export.metadata import FORMAT, INPUT_UNITS
from navlearn.fusion.error_state import ERROR_UNITS, error_layout
from navlearn.fusion.options import GYRO_TERMS, SPEED_TERMS, EkfOptions

Fitted = Callable[..., FittedErrorModel]
Inputs = Callable[..., Tensor]

FAMILIES = ["anarx", "fos", "fos fed back", "pci", "ridge"]
NAMED = TrainingSource(inputs=("yaw_rate", "speed", "delay"), outputs=("along", "cross"))


@pytest.mark.parametrize("lags", [1, 3])
@pytest.mark.parametrize("kind", FAMILIES)
def test_torchscript_equals_eager_in_stream_and_window(
    tmp_path: Path, lags: int, kind: str, make_fitted: Fitted, make_inputs: Inputs
) -> None:
    fitted = make_fitted(lags=lags, kind=kind)
    outputs = len(fitted.record.source.outputs)
    report = export_predictor(fitted, tmp_path / "p.pt", check_inputs=make_inputs())
    assert max(report.differences.values()) <= 1e-12
    assert set(report.differences) >= {"forward", "step", "step against forward"}
    module = load_predictor(report.path).module
    u = make_inputs(33, seed=7)
    y_start = torch.tensor([0.02, -0.01], dtype=torch.float64)[:outputs]
    state = module.initial_state(u[0], y_start)
    streamed = []
    for row in u:
        y, state = module.step(row, state)
        streamed.append(y)
    expected = fitted.model(u, y_start)
    torch.testing.assert_close(torch.stack(streamed), expected, rtol=0.0, atol=1e-12)
    torch.testing.assert_close(module(u, y_start), expected, rtol=0.0, atol=1e-12)
    for steps in (0, 3, 99):
        expected = fitted.model.prediction_variance(steps)
        assert torch.equal(module.prediction_variance(steps), expected)


@pytest.mark.parametrize("kind", ["anarx", "fos", "pci"])
def test_reload_in_a_fresh_process_without_navlearn(
    tmp_path: Path, kind: str, make_fitted: Fitted, make_inputs: Inputs
) -> None:
    fitted = make_fitted(kind=kind)
    export_predictor(fitted, tmp_path / "p.pt", check_inputs=make_inputs())
    u = make_inputs(12, seed=5)
    torch.save(u, tmp_path / "u.pt")
    program = (
        "import sys, torch\n"
        "sys.modules['navlearn'] = None\n"
        "module = torch.jit.load('p.pt')\n"
        "torch.save(module(torch.load('u.pt')), 'y.pt')\n"
        "print(module.metadata)\n"
    )
    done = subprocess.run(
        [sys.executable, "-c", program], cwd=tmp_path, check=True, capture_output=True, text=True
    )
    found = torch.load(tmp_path / "y.pt", weights_only=True)
    torch.testing.assert_close(found, fitted.model(u), rtol=0.0, atol=1e-12)
    about = json.loads(done.stdout)
    assert (about["kind"], about["inputs"]) == (kind, ["yaw_rate", "speed", "delay"])


@pytest.mark.parametrize("kind", ["anarx", "fos fed back", "pci", "ridge"])
def test_torch_export_takes_any_batch_and_length(
    tmp_path: Path, kind: str, make_fitted: Fitted, make_inputs: Inputs
) -> None:
    fitted = make_fitted(kind=kind)
    report = export_predictor(
        fitted, tmp_path / "p.pt2", check_inputs=make_inputs(), kind="torch_export"
    )
    loaded = load_predictor(report.path)
    assert loaded.kind == "torch_export"
    assert loaded.metadata == describe(fitted)
    for batch, rows in ((1, 60), (3, 17), (2, 2)):
        u = torch.stack([make_inputs(rows, seed=k) for k in range(batch)])
        torch.testing.assert_close(loaded.module(u), fitted.model(u), rtol=0.0, atol=1e-12)


@pytest.mark.parametrize("shape", [(2,), (5, 4), (4, 6, 2)])
def test_inputs_of_a_wrong_shape_are_refused_by_name(
    shape: tuple[int, ...], tmp_path: Path, make_fitted: Fitted, make_inputs: Inputs
) -> None:
    path = tmp_path / "p.pt"
    export_predictor(make_fitted(), path, check_inputs=make_inputs())
    predictor = load_predictor(path).module
    state = predictor.initial_state(make_inputs()[0])
    u = torch.zeros(shape, dtype=torch.float64)
    expected = r"expected \(\.\.\., (T, )?3\) with the columns yaw_rate, speed, delay"
    for call in (lambda: predictor.step(u, state), lambda: predictor.initial_state(u)):
        with pytest.raises(torch.jit.Error, match=expected):
            call()
    with pytest.raises(torch.jit.Error, match=expected):
        predictor(u)
    with pytest.raises(torch.jit.Error, match=expected):
        predictor(make_inputs()[0])


def test_metadata_survive_and_tell_units(
    tmp_path: Path, make_fitted: Fitted, make_inputs: Inputs
) -> None:
    fitted = make_fitted()
    export_predictor(fitted, tmp_path / "p.pt", check_inputs=make_inputs())
    found = load_predictor(tmp_path / "p.pt").metadata
    assert found == describe(fitted)
    assert dict(zip(found.inputs, found.input_units, strict=True))["speed"] == "m/s"
    assert found.output_units == ("m per step", "m per step")
    assert (found.time_step_s, found.memory) == (1.0, 2)
    assert found.trained_on["time_span_s"] == [600.0, 1200.0]
    assert found.trained_on["valid_loss"] is None
    assert found.versions["torch"] == "2.6"


@pytest.mark.parametrize("kind", ["fos", "pci"])
def test_fitters_tell_what_they_were_fitted_to(kind: str, make_fitted: Fitted) -> None:
    found = describe(make_fitted(kind=kind))
    assert (found.kind, found.acts_on, found.memory) == (kind, "gyro_rate", 2 + (kind == "pci"))
    assert found.output_units == ("rad/s",)
    assert found.trained_on["samples"] == 398
    assert found.trained_on["trainer"] == kind


def test_inputs_may_bring_their_units(
    tmp_path: Path, make_fitted: Fitted, make_inputs: Inputs
) -> None:
    source = TrainingSource(
        inputs=("temperature", "speed", "height"),
        outputs=("azimuth",),
        acts_on="azimuth",
        input_units=("°C", "m/s", "m"),
    )
    path = tmp_path / "p.pt"
    export_predictor(make_fitted(kind="pci", source=source), path, check_inputs=make_inputs())
    assert load_predictor(path).metadata.input_units == ("°C", "m/s", "m")
    filtered = replace(source, inputs=("azimuth", "gyro_bias", "speed_scale"), input_units=())
    found = describe(make_fitted(kind="fos", source=filtered))
    assert found.input_units == ("rad", "rad/s", "1")
    with pytest.raises(ConfigError, match="2 input_units for 3 inputs"):
        replace(source, input_units=("rad", "m/s"))


def test_every_channel_and_target_has_a_unit() -> None:
    assert tuple(INPUT_UNITS) == CHANNELS
    shen = error_layout(EkfOptions(model="shen2010")).names
    terms = {f"gyro_{term}" for term in GYRO_TERMS} | {f"speed_{term}" for term in SPEED_TERMS}
    assert set(ERROR_UNITS) == terms | set(shen) | {"pitch_bias"}
    assert not set(ERROR_UNITS) & set(INPUT_UNITS)
    assert set(OUTPUT_UNITS) == set(ACTS_ON)
    scale = signature(build_regressors).parameters["delay_scale"].default
    assert INPUT_UNITS["delay"] == f"{scale:g} s"


def test_nothing_is_overwritten_without_force(
    tmp_path: Path, make_fitted: Fitted, make_inputs: Inputs
) -> None:
    path = tmp_path / "p.pt"
    path.write_text("mine")
    with pytest.raises(OutputExistsError, match="exists already"):
        export_predictor(make_fitted(), path, check_inputs=make_inputs())
    assert path.read_text() == "mine"
    export_predictor(make_fitted(), path, check_inputs=make_inputs(), force=True)
    assert load_predictor(path).kind == "torchscript"


class Drifting(Anarx):
    """A model whose windows and steps do not agree."""

    def forward(self, u: Tensor, y_start: Tensor | None = None) -> Tensor:
        y, _ = self.run(u, self.initial_state(u[..., 0, :], y_start))
        return y + 1e-9 * u[..., :1].abs().sum(-2, keepdim=True)


def test_what_disagrees_is_not_written(
    tmp_path: Path, make_fitted: Fitted, make_inputs: Inputs
) -> None:
    fitted = make_fitted()
    drifting = Drifting(fitted.options)
    drifting.set_variance(fitted.model.variance)
    drifting.load_state_dict(fitted.model.state_dict())
    with pytest.raises(FitError, match="step against forward"):
        export_predictor(
            replace(fitted, model=drifting), tmp_path / "p.pt", check_inputs=make_inputs()
        )
    assert list(tmp_path.iterdir()) == []


class Branching(Anarx):
    """A model whose steps depend on values, which no exported program can follow."""

    def step(self, u: Tensor, state: Tensor) -> tuple[Tensor, Tensor]:
        return super().step(u if float(u.sum()) > 0.0 else -u, state)


def test_what_torch_export_cannot_follow_is_refused_with_advice(
    tmp_path: Path, make_fitted: Fitted, make_inputs: Inputs
) -> None:
    fitted = make_fitted()
    branching = replace(fitted, model=Branching(fitted.options))
    with pytest.raises(FitError, match=r"export it as TorchScript"):
        export_predictor(
            branching, tmp_path / "p.pt2", check_inputs=make_inputs(), kind="torch_export"
        )
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    "inputs",
    [
        torch.zeros(3, 3, dtype=torch.float64),
        torch.zeros(9, 2, dtype=torch.float64),
        torch.zeros(9, dtype=torch.float64),
        torch.full((9, 3), float("nan"), dtype=torch.float64),
    ],
)
def test_inputs_to_check_with_must_be_real(
    tmp_path: Path, inputs: Tensor, make_fitted: Fitted
) -> None:
    with pytest.raises(ShapeError, match="check_inputs"):
        export_predictor(make_fitted(), tmp_path / "p.pt", check_inputs=inputs)


def test_unknown_format_is_refused(
    tmp_path: Path, make_fitted: Fitted, make_inputs: Inputs
) -> None:
    kind: Any = "onnx"
    with pytest.raises(ConfigError, match="'onnx'"):
        export_predictor(make_fitted(), tmp_path / "p", check_inputs=make_inputs(), kind=kind)


@pytest.mark.parametrize(
    "source",
    [
        TrainingSource(),
        replace(NAMED, inputs=("yaw_rate", "speed", "colour")),
        replace(NAMED, outputs=()),
    ],
)
def test_a_record_without_names_is_refused(source: TrainingSource, make_fitted: Fitted) -> None:
    with pytest.raises(ConfigError, match="needs both named"):
        describe(make_fitted(source=source))


def test_files_that_are_no_predictors(tmp_path: Path) -> None:
    with pytest.raises(LogNotFoundError, match="no such predictor"):
        load_predictor(tmp_path / "absent.pt")
    (tmp_path / "text.pt").write_text("hello")
    torch.save({"a": 1}, tmp_path / "tensors.pt")
    torch.jit.script(torch.nn.Linear(1, 1)).save(str(tmp_path / "foreign.pt"))
    for name in ("text.pt", "tensors.pt", "foreign.pt"):
        with pytest.raises(ConfigError, match=name):
            load_predictor(tmp_path / name)


@pytest.mark.parametrize("kind", ["torchscript", "torch_export"])
def test_damaged_predictors_are_refused(
    tmp_path: Path, make_fitted: Fitted, make_inputs: Inputs, kind: Any
) -> None:
    path = tmp_path / "whole"
    export_predictor(make_fitted(), path, check_inputs=make_inputs(), kind=kind)
    whole = path.read_bytes()
    for length in (0, 10, len(whole) // 3, len(whole) // 2, len(whole) - 30):
        (tmp_path / "cut").write_bytes(whole[:length])
        with pytest.raises(ConfigError, match="cut: neither a TorchScript nor"):
            load_predictor(tmp_path / "cut")


@pytest.mark.parametrize("text", ["", "{}", "[]", "3", '{"format": "other"}'])
def test_metadata_that_are_not_ours(text: str) -> None:
    with pytest.raises(ConfigError):
        PredictorMetadata.from_json(text)
    with pytest.raises(ConfigError):
        PredictorMetadata.from_json(json.dumps({"format": FORMAT}))


def test_example_comes_back_as_it_was(tmp_path: Path, make_inputs: Inputs) -> None:
    save_example(make_inputs(9), tmp_path / "example.pt")
    assert torch.equal(load_example(tmp_path / "example.pt"), make_inputs(9))
    with pytest.raises(LogNotFoundError, match="run the recipe again"):
        load_example(tmp_path / "absent.pt")
    torch.save({"other": 1}, tmp_path / "other.pt")
    with pytest.raises(ConfigError, match="no example inputs"):
        load_example(tmp_path / "other.pt")
