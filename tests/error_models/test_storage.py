import subprocess
import sys
from dataclasses import replace

import pytest
import torch

from navlearn.error_models.anarx import Anarx, AnarxOptions
from navlearn.error_models.base import (
    FittedErrorModel,
    TrainingCurves,
    TrainingRecord,
    TrainingSource,
)
from navlearn.error_models.storage import load_error_model, save_error_model
from navlearn.errors import ConfigError, LogNotFoundError, OutputExistsError


@pytest.fixture
def fitted():
    options = AnarxOptions(inputs=2, outputs=2, lags=3, hidden=2, activation="tanh")
    model = Anarx(options)
    torch.manual_seed(0)
    with torch.no_grad():
        for parameter in model.parameters():
            parameter.normal_(std=0.3)
    model.set_variance(torch.rand(7, 2).double())
    record = TrainingRecord(
        source=TrainingSource(
            logs=("a", "b"), regime="adapted", inputs=("speed", "delay"), outputs=("x", "y")
        ),
        time_span=(1.5, 99.0),
        samples=10,
        validation_samples=0,
        trainer="lm",
        loop="closed",
        iterations=3,
        stopped="cost",
        seed=5,
        train_loss=0.1,
        valid_loss=0.25,
        versions=(("navlearn", "0"), ("torch", "2")),
    )
    curves = TrainingCurves(train=(1.0, 0.1), valid=())
    return FittedErrorModel(
        kind="anarx", model=model, options=options, record=record, curves=curves
    )


def test_what_could_not_be_read_back_is_not_written(fitted, tmp_path):
    with pytest.raises(ConfigError, match="kind 'fos' cannot be saved"):
        save_error_model(replace(fitted, kind="fos"), tmp_path / "model.pt")
    assert not (tmp_path / "model.pt").exists()


def test_what_is_saved_comes_back(fitted, tmp_path):
    path = tmp_path / "deep" / "model.pt"
    save_error_model(fitted, path)
    found = load_error_model(path)
    assert (found.kind, found.options) == (fitted.kind, fitted.options)
    assert found.record == fitted.record
    assert found.curves == fitted.curves
    u = torch.randn(3, 20, 2).double()
    assert torch.equal(found.model(u), fitted.model(u))
    assert torch.equal(found.model.prediction_variance(6), fitted.model.prediction_variance(6))


def test_it_comes_back_in_a_fresh_process(fitted, tmp_path):
    save_error_model(fitted, tmp_path / "model.pt")
    u = torch.linspace(-1, 1, 40, dtype=torch.float64).reshape(20, 2)
    program = (
        "import sys, torch\n"
        "from navlearn.error_models.storage import load_error_model\n"
        "u = torch.linspace(-1, 1, 40, dtype=torch.float64).reshape(20, 2)\n"
        "print(load_error_model(sys.argv[1]).model(u).sum().item().hex())\n"
        "assert 'lightning' not in sys.modules\n"
    )
    out = subprocess.run(
        [sys.executable, "-c", program, str(tmp_path / "model.pt")],
        check=True,
        capture_output=True,
        text=True,
    )
    assert float.fromhex(out.stdout.strip()) == pytest.approx(
        float(fitted.model(u).sum().detach()), abs=1e-12
    )


def test_nothing_is_overwritten_by_accident(fitted, tmp_path):
    path = tmp_path / "model.pt"
    save_error_model(fitted, path)
    with pytest.raises(OutputExistsError, match="force=True"):
        save_error_model(fitted, path)
    save_error_model(fitted, path, force=True)


def test_other_files_are_refused(fitted, tmp_path):
    with pytest.raises(LogNotFoundError, match="no such file"):
        load_error_model(tmp_path / "missing.pt")
    (tmp_path / "noise.pt").write_bytes(b"not a model at all")
    with pytest.raises(ConfigError, match="not a navlearn error model"):
        load_error_model(tmp_path / "noise.pt")
    torch.save({"about": '{"format": "navlearn error model 9"}', "weights": {}}, tmp_path / "n.pt")
    with pytest.raises(ConfigError, match="expected 'navlearn error model 1'"):
        load_error_model(tmp_path / "n.pt")
    # A pickle that would run code is not run.
    torch.save(fitted, tmp_path / "pickle.pt")
    with pytest.raises(ConfigError, match="UnpicklingError"):
        load_error_model(tmp_path / "pickle.pt")


def test_sources_know_their_regimes():
    with pytest.raises(ConfigError, match="regime 'offline'"):
        TrainingSource(regime="offline")
    with pytest.raises(ConfigError, match="acts_on 'velocity'"):
        TrainingSource(acts_on="velocity")
    with pytest.raises(ConfigError, match="time_step"):
        TrainingSource(time_step=0.0)
