import json
import subprocess
import sys
from dataclasses import asdict, replace

import pytest
import torch

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
from navlearn.error_models.storage import load_error_model, save_error_model
from navlearn.error_models.storage_kinds import KINDS
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


def fitted_of(kind, anarx):
    """Return a fitted model of two inputs."""
    if kind == "anarx":
        return anarx
    generator = torch.Generator().manual_seed(1)
    u = torch.randn(400, 2, generator=generator).double()
    v = u[:, 0] + 0.5 * u[:, 1].roll(1) - 0.2 * u[:, 0].roll(2)
    y = (0.3 + v + 0.4 * v**2).unsqueeze(-1) + 0.1 * torch.randn(400, 1, generator=generator)
    source = replace(anarx.record.source, outputs=("x",), acts_on="azimuth")
    if kind == "ridge":
        terms = product_terms(("speed", "abs_speed", "speed*delay"), ("speed", "delay"), 0.0)
        model = RidgeModel(RidgeOptions(inputs=2, terms=terms.names))
        model.set_fit(terms, torch.tensor([0.1, -0.2, 0.05]).double(), torch.eye(3).double(), u)
        return replace(anarx, kind="ridge", model=model.eval(), options=model.options)
    if kind == "fos":
        options = FosOptions(lags=2, output_lags=1, max_terms=5, ridge=1e-6)
        return fit_fos(u, y, options=options, source=source)
    assert kind == "pci"
    return fit_pci(u, y, PciOptions(inputs=2, lags=2, cascades=3), source=source)


def test_what_could_not_be_read_back_is_not_written(fitted, tmp_path):
    with pytest.raises(
        ConfigError, match="kind 'crystal' cannot be saved, only anarx, fos, pci, ridge"
    ):
        save_error_model(replace(fitted, kind="crystal"), tmp_path / "model.pt")
    assert not (tmp_path / "model.pt").exists()


@pytest.mark.parametrize("kind", sorted(KINDS))
def test_what_is_saved_comes_back(kind, fitted, tmp_path):
    fitted = fitted_of(kind, fitted)
    path = tmp_path / "deep" / "model.pt"
    save_error_model(fitted, path)
    found = load_error_model(path)
    assert type(found) is type(fitted)
    # Compared as text: a loss may be NaN, which equals nothing.
    for name in ("kind", "options", "record", "curves", *KINDS[kind].own):
        assert repr(getattr(found, name)) == repr(getattr(fitted, name)), name
    u = 2.0 * torch.randn(3, 20, 2, generator=torch.Generator().manual_seed(2)).double()
    y = fitted.model(u)
    assert float(y.detach().std()) > 0.0
    assert torch.equal(found.model(u), y)
    for steps in (1, 6, 99):
        variance = fitted.model.prediction_variance(steps)
        assert torch.equal(found.model.prediction_variance(steps), variance)
    assert not found.model.training


def test_a_model_without_cascades_comes_back(tmp_path):
    generator = torch.Generator().manual_seed(1)
    u, y = (torch.randn(300, generator=generator).double() for _ in range(2))
    fitted = fit_pci(u, y, PciOptions(inputs=1))
    assert fitted.cascades == 0
    save_error_model(fitted, tmp_path / "model.pt")
    found = load_error_model(tmp_path / "model.pt")
    assert torch.equal(found.model(u[:, None]), fitted.model(u[:, None]))


def test_files_of_the_earlier_form_are_read(fitted, tmp_path):
    about = {
        "format": "navlearn error model 1",
        "kind": "anarx",
        "options": asdict(fitted.options),
        "record": asdict(fitted.record),
        "curves": asdict(fitted.curves),
    }
    weights = fitted.model.state_dict()
    torch.save({"about": json.dumps(about), "weights": weights}, tmp_path / "model.pt")
    found = load_error_model(tmp_path / "model.pt")
    assert (found.options, found.record) == (fitted.options, fitted.record)
    u = torch.randn(3, 20, 2).double()
    assert torch.equal(found.model(u), fitted.model(u))


def spoil(path, change):
    """Change what stands in a file, in its description and its weights."""
    content = torch.load(path, weights_only=True)
    about = json.loads(content["about"])
    change(about, content["weights"])
    torch.save({"about": json.dumps(about), "weights": content["weights"]}, path)


@pytest.mark.parametrize("kind", sorted(KINDS))
@pytest.mark.parametrize(
    "change",
    [
        lambda about, weights: about.pop("description"),
        lambda about, weights: about["description"].update(colour=1, options={"colour": 1}),
        lambda about, weights: about.pop("record"),
        lambda about, weights: about.update(curves=[]),
        lambda about, weights: weights.pop("variance"),
        lambda about, weights: weights.update(variance=torch.zeros(3, 4, 5).double()),
        lambda about, weights: weights.update(u_mean=torch.zeros(9).double()),
        lambda about, weights: weights.update(further=torch.zeros(9).double()),
    ],
)
def test_what_does_not_fit_together_is_refused(kind, change, fitted, tmp_path):
    path = tmp_path / "model.pt"
    save_error_model(fitted_of(kind, fitted), path)
    spoil(path, change)
    with pytest.raises(ConfigError, match=f"model.pt: a model of kind '{kind}' that cannot"):
        load_error_model(path)


def test_cascades_of_different_numbers_are_refused(fitted, tmp_path):
    path = tmp_path / "model.pt"
    save_error_model(fitted_of("pci", fitted), path)
    spoil(path, lambda about, weights: weights.update(low=weights["low"].repeat(2)))
    with pytest.raises(ConfigError, match=r"have the lengths \[1, "):
        load_error_model(path)


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
    torch.save({"about": "[1]", "weights": {}}, tmp_path / "list.pt")
    with pytest.raises(ConfigError, match="not a navlearn error model"):
        load_error_model(tmp_path / "list.pt")
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
