"""Fitting: recovery of a known system, determinism, resume, early stopping, bad data."""

import math

import pytest
import torch

from navlearn.error_models.anarx import Anarx, AnarxOptions
from navlearn.error_models.base import TrainingSource
from navlearn.errors import ConfigError, FitError, OutputExistsError, ShapeError
from navlearn.learning import lm_training
from navlearn.learning.fit import fit_anarx
from navlearn.learning.options import TrainingOptions
from navlearn.learning.windows import Windows, windows_from_series

FAMILY = AnarxOptions(inputs=2, outputs=1, lags=2, hidden=2, linear_path=False)


def system(seed=0, options=FAMILY):
    """A network of the family with random weights, and a long record of it."""
    generator = torch.Generator().manual_seed(seed)
    model = Anarx(options)
    with torch.no_grad():
        for parameter in model.parameters():
            if parameter.requires_grad:
                parameter.copy_(torch.randn(parameter.shape, generator=generator).double())
    u = 4.0 * torch.rand(1500, options.inputs, generator=generator).double() - 2.0
    with torch.no_grad():
        return u, model(u)


def noisy_windows(seed=0, count=24, rows=20):
    u, y = system(seed)
    windows = windows_from_series(u, y, length=rows, stride=rows)
    noise = torch.randn(windows.y.shape, generator=torch.Generator().manual_seed(seed)).double()
    windows = windows._replace(y=windows.y + 0.1 * noise)
    half = count // 2
    return (
        Windows(*(part[:half] for part in windows[:5])),
        Windows(*(part[half:count] for part in windows[:5])),
    )


@pytest.mark.parametrize("loop", ["open", "closed"])
def test_recovers_a_system_of_its_own_family(loop):
    u, y = system()
    train = windows_from_series(u[:1000], y[:1000], length=50, stride=50, warmup=2)
    training = TrainingOptions(
        loop=loop, ridge=0.0, starts=8, start_iterations=100, max_iterations=100
    )
    fitted = fit_anarx(train, None, FAMILY, training, progress=False)
    model = fitted.model
    with torch.no_grad():
        state = model.warm_state(u[1000:1010], y[1000:1010], y[999])
        run, _ = model.run(u[1010:], state)
    error = (run - y[1010:]).square().mean().sqrt() / y.std()
    assert float(error) < 1e-4
    assert fitted.record.train_loss < 1e-8


def test_closed_loop_training_beats_open_loop_training_in_closed_loop():
    train, valid = noisy_windows()
    options = AnarxOptions(inputs=2, outputs=1, lags=2, hidden=3)
    spread = {}
    for loop in ("open", "closed"):
        training = TrainingOptions(loop=loop, max_iterations=30)
        fitted = fit_anarx(train, None, options, training, progress=False)
        with torch.no_grad():
            spread[loop] = float((fitted.model(train.u, train.y_start) - train.y).square().mean())
    assert spread["closed"] < spread["open"]
    assert valid.u.shape == train.u.shape


def test_the_seed_decides_everything():
    train, valid = noisy_windows()
    training = TrainingOptions(max_iterations=6, seed=3)
    first = fit_anarx(train, valid, FAMILY, training, progress=False)
    second = fit_anarx(train, valid, FAMILY, training, progress=False)
    assert first.record == second.record
    for a, b in zip(first.model.parameters(), second.model.parameters(), strict=True):
        assert torch.equal(a, b)
    other = fit_anarx(
        train, valid, FAMILY, TrainingOptions(max_iterations=6, seed=4), progress=False
    )
    assert not torch.equal(other.model.weight, first.model.weight)


def test_resumed_training_ends_where_an_uninterrupted_one_does(tmp_path, monkeypatch):
    train, valid = noisy_windows()
    training = TrainingOptions(max_iterations=15, patience=99, checkpoint_every=4)
    whole = fit_anarx(train, valid, FAMILY, training, progress=False)
    write = lm_training.write_checkpoint

    def write_then_break(path, content):
        write(path, content)
        if content["state"]["iteration"] == 8:
            raise KeyboardInterrupt

    monkeypatch.setattr(lm_training, "write_checkpoint", write_then_break)
    with pytest.raises(KeyboardInterrupt):
        fit_anarx(train, valid, FAMILY, training, progress=False, checkpoint_dir=tmp_path)
    monkeypatch.undo()
    with pytest.raises(OutputExistsError, match="resume=True"):
        fit_anarx(train, valid, FAMILY, training, progress=False, checkpoint_dir=tmp_path)
    # Without new random starts: what follows comes from the checkpoint.
    monkeypatch.setattr(lm_training, "best_start", None)
    rest = fit_anarx(
        train, valid, FAMILY, training, progress=False, checkpoint_dir=tmp_path, resume=True
    )
    assert rest.record == whole.record
    assert rest.curves == whole.curves
    for a, b in zip(rest.model.parameters(), whole.model.parameters(), strict=True):
        assert torch.equal(a, b)
    # A finished training is read, not repeated.
    done = fit_anarx(
        train, valid, FAMILY, training, progress=False, checkpoint_dir=tmp_path, resume=True
    )
    assert done.record == whole.record


def test_a_checkpoint_of_other_data_is_refused(tmp_path):
    train, valid = noisy_windows()
    training = TrainingOptions(max_iterations=2)
    fit_anarx(train, valid, FAMILY, training, progress=False, checkpoint_dir=tmp_path)
    changed = train._replace(y=train.y + 1e-6)
    with pytest.raises(ConfigError, match="other data or options"):
        fit_anarx(
            changed, valid, FAMILY, training, progress=False, checkpoint_dir=tmp_path, resume=True
        )
    (tmp_path / "lm.pt").write_bytes(b"torn")
    with pytest.raises(ConfigError, match="not a readable checkpoint"):
        fit_anarx(
            train, valid, FAMILY, training, progress=False, checkpoint_dir=tmp_path, resume=True
        )


def test_early_stopping_keeps_the_best_on_validation():
    train, valid = noisy_windows(count=8)
    options = AnarxOptions(inputs=2, outputs=1, lags=3, hidden=6)
    training = TrainingOptions(max_iterations=200, patience=4, ridge=0.0)
    fitted = fit_anarx(train, valid, options, training, progress=False)
    curve = fitted.curves.valid
    best = curve.index(min(curve))
    assert fitted.record.stopped == "patience"
    assert len(curve) - 1 - best == 4
    assert fitted.record.valid_loss == min(curve)
    assert fitted.record.train_loss > min(fitted.curves.train)
    model = fitted.model
    with torch.no_grad():
        run = model.standardise_outputs(model(valid.u, valid.y_start))
    loss = (run - model.standardise_outputs(valid.y)).square().mean()
    if int(model.count_clamped(valid.u).sum()) == 0:
        assert float(loss) == pytest.approx(min(curve), rel=1e-9)


def test_padding_is_never_read():
    train, valid = noisy_windows()
    weight = train.weight.clone()
    weight[:, 15:] = 0.0
    garbage = train.y.clone()
    garbage[:, 15:] = 1e9
    padded = train._replace(weight=weight)
    training = TrainingOptions(max_iterations=3)
    first = fit_anarx(padded, valid, FAMILY, training, progress=False)
    second = fit_anarx(padded._replace(y=garbage), valid, FAMILY, training, progress=False)
    assert torch.equal(first.model.weight, second.model.weight)
    assert first.record.samples == 12 * 15


def test_variance_by_horizon_is_that_of_the_validation_runs():
    train, valid = noisy_windows()
    fitted = fit_anarx(train, valid, FAMILY, TrainingOptions(max_iterations=5), progress=False)
    with torch.no_grad():
        residual = fitted.model(valid.u, valid.y_start) - valid.y
    expected = residual.square().mean(0)
    for k in (1, 7, 20):
        torch.testing.assert_close(fitted.model.prediction_variance(k), expected[k - 1])


@pytest.mark.parametrize("objective", ["step", "accumulated"])
def test_units_do_not_matter(objective):
    """In other units of inputs and outputs training finds the same network."""
    train, valid = noisy_windows()
    training = TrainingOptions(max_iterations=5, objective=objective)
    inputs, outputs = torch.tensor([100.0, 1e-3]).double(), 0.01

    def convert(windows):
        return windows._replace(
            u=7.0 + inputs * windows.u, y=outputs * windows.y, y_start=outputs * windows.y_start
        )

    plain = fit_anarx(train, valid, FAMILY, training, progress=False)
    other = fit_anarx(convert(train), convert(valid), FAMILY, training, progress=False)
    with torch.no_grad():
        expected = outputs * plain.model(valid.u, valid.y_start)
        found = other.model(convert(valid).u, convert(valid).y_start)
    torch.testing.assert_close(found, expected, rtol=1e-5, atol=1e-8)
    assert other.record.valid_loss == pytest.approx(plain.record.valid_loss, rel=1e-6)


def test_the_record_says_what_was_used():
    train, valid = noisy_windows()
    source = TrainingSource(logs=("drive",), inputs=("a", "b"), outputs=("c",), time_step=0.5)
    fitted = fit_anarx(
        train, valid, FAMILY, TrainingOptions(max_iterations=2), source=source, progress=False
    )
    record = fitted.record
    assert record.source == source
    assert (record.samples, record.validation_samples) == (240, 240)
    assert record.time_span == (1.0, float(train.start_time[-1]) + 10.0)
    assert (record.trainer, record.loop, record.seed) == ("lm", "closed", 0)
    assert record.iterations == 2
    assert len(fitted.curves.train) == 3
    assert dict(record.versions)["torch"] == str(torch.__version__)
    alone = fit_anarx(train, None, FAMILY, TrainingOptions(max_iterations=2), progress=False)
    assert math.isnan(alone.record.valid_loss)
    assert alone.curves.valid == ()


def test_the_accumulated_objective_lowers_the_accumulated_error():
    train, _ = noisy_windows()
    drift = {}
    for objective in ("step", "accumulated"):
        training = TrainingOptions(objective=objective, max_iterations=40, ridge=0.0)
        fitted = fit_anarx(train, None, FAMILY, training, progress=False)
        with torch.no_grad():
            residual = fitted.model(train.u, train.y_start) - train.y
        drift[objective] = float(residual.cumsum(1).square().mean())
    assert drift["accumulated"] < 0.98 * drift["step"]


def test_a_progress_bar_is_shown_where_wanted(capsys):
    train, valid = noisy_windows()
    fit_anarx(train, valid, FAMILY, TrainingOptions(max_iterations=2), progress=True)
    assert "Levenberg-Marquardt" in capsys.readouterr().err
    fit_anarx(train, valid, FAMILY, TrainingOptions(max_iterations=2), progress=False)
    assert capsys.readouterr() == ("", "")


def test_bad_data_is_refused():
    train, valid = noisy_windows()
    spoiled = train.u.clone()
    spoiled[2, 3, 1] = torch.nan
    with pytest.raises(FitError, match=r"training windows: u holds 1 values.*\(2, 3, 1\)"):
        fit_anarx(train._replace(u=spoiled), valid, FAMILY, progress=False)
    with pytest.raises(FitError, match="validation windows: u holds"):
        fit_anarx(train, valid._replace(u=spoiled), FAMILY, progress=False)
    with pytest.raises(ShapeError, match="2 inputs and 1 outputs, but the options say 3 and 1"):
        fit_anarx(train, valid, AnarxOptions(inputs=3), progress=False)


@pytest.mark.parametrize(
    ("wrong", "said"),
    [
        ({"trainer": "sgd"}, "trainer 'sgd'"),
        ({"patience": 0}, "patience is 0"),
        ({"learning_rate": 0.0}, "learning_rate"),
        ({"loop": "open", "objective": "accumulated"}, "needs loop: closed"),
    ],
)
def test_options_refuse(wrong, said):
    with pytest.raises(ConfigError, match=said):
        TrainingOptions(**wrong)
