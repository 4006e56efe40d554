"""Training by Adam through Lightning: resume, early stopping, horizon, silence."""

import pytest
import torch

from navlearn.error_models.anarx import Anarx, AnarxOptions
from navlearn.learning import adam_training
from navlearn.learning.anarx_least_squares import pad_windows
from navlearn.learning.datamodule import WindowBatches
from navlearn.learning.fit import fit_anarx
from navlearn.learning.options import TrainingOptions
from navlearn.learning.task import AnarxTask
from navlearn.learning.windows import Windows, check_windows

SHAPE = AnarxOptions(inputs=2, outputs=1, lags=2, hidden=3)


def some_windows(seed, count=10, rows=15):
    generator = torch.Generator().manual_seed(seed)
    u = torch.randn(count, rows, 2, generator=generator).double()
    noise = torch.randn(count, rows, 1, generator=generator).double()
    y = torch.tanh(2.0 * u[..., :1] * u[..., 1:]) + 0.05 * noise
    return Windows(u, y, torch.ones(count, rows).double(), 20.0 * torch.arange(count).double())


TRAIN, VALID = some_windows(0), some_windows(1)


def options(**changes):
    return TrainingOptions(
        **{
            "trainer": "adam",
            "max_iterations": 9,
            "batch_size": 4,
            "checkpoint_every": 2,
            "start_iterations": 0,
            "starts": 1,
            "patience": 50,
            **changes,
        }
    )


def test_resumed_training_ends_where_an_uninterrupted_one_does(tmp_path, monkeypatch):
    training = options(first_horizon=3, horizon_epochs=5)
    whole = fit_anarx(TRAIN, VALID, SHAPE, training, progress=False)
    note = adam_training.EpochLog.on_train_epoch_start

    def break_at_six(self, trainer, pl_module):
        if trainer.current_epoch == 5:
            raise RuntimeError("power cut")
        note(self, trainer, pl_module)

    monkeypatch.setattr(adam_training.EpochLog, "on_train_epoch_start", break_at_six)
    with pytest.raises(RuntimeError, match="power cut"):
        fit_anarx(TRAIN, VALID, SHAPE, training, progress=False, checkpoint_dir=tmp_path)
    monkeypatch.undo()
    monkeypatch.setattr(adam_training, "best_start", None)
    for _ in range(2):
        rest = fit_anarx(
            TRAIN, VALID, SHAPE, training, progress=False, checkpoint_dir=tmp_path, resume=True
        )
        assert rest.record == whole.record
        assert rest.curves == whole.curves
        for a, b in zip(rest.model.parameters(), whole.model.parameters(), strict=True):
            assert torch.equal(a, b)


def test_the_loss_falls_and_the_best_epoch_is_kept():
    training = options(max_iterations=60, learning_rate=0.02, batch_size=0)
    fitted = fit_anarx(TRAIN, VALID, SHAPE, training, progress=False)
    assert fitted.curves.train[-1] < 0.8 * fitted.curves.train[0]
    assert fitted.record.valid_loss == min(fitted.curves.valid)
    model = fitted.model
    task = AnarxTask(model, training, 15)
    with torch.no_grad():
        loss = float(task.mean_square(pad_windows(model, check_windows(VALID))))
    assert loss == pytest.approx(min(fitted.curves.valid), rel=1e-12)


def test_early_stopping_ends_training():
    training = options(max_iterations=300, patience=3, learning_rate=0.3)
    fitted = fit_anarx(TRAIN, VALID, SHAPE, training, progress=False)
    assert fitted.record.stopped == "patience"
    assert fitted.record.iterations < 300
    curve = fitted.curves.valid
    assert len(curve) - 1 - curve.index(min(curve)) == 3


def test_the_loss_is_that_of_the_free_run():
    model = Anarx(SHAPE)
    with torch.no_grad():
        for parameter in model.parameters():
            parameter.normal_(std=0.3, generator=torch.Generator().manual_seed(2))
    windows = check_windows(TRAIN)
    padded = pad_windows(model, windows)
    residual = model(windows.u) - windows.y
    for changes, expected in (
        ({}, residual.square().mean()),
        ({"objective": "accumulated"}, residual.cumsum(1).square().mean()),
        ({"loop": "open"}, (model.open_loop(windows.u, windows.y) - windows.y).square().mean()),
    ):
        task = AnarxTask(model, options(**changes), 15)
        torch.testing.assert_close(task.mean_square(padded), expected)


def test_the_horizon_grows_to_the_whole_window():
    task = AnarxTask(Anarx(SHAPE), options(first_horizon=3, horizon_epochs=4), 15)
    assert [task.horizon(epoch) for epoch in range(6)] == [3, 6, 9, 12, 15, 15]
    assert AnarxTask(Anarx(SHAPE), options(), 15).horizon(0) == 15


def test_batches_hold_every_window_once():
    padded = pad_windows(Anarx(SHAPE), check_windows(TRAIN))
    batches = WindowBatches(padded, 4, torch.randperm(10))
    assert [b.u.shape[0] for b in batches] == [4, 4, 2]
    assert len(batches) == 3
    seen = torch.cat([b.y for b in batches]).reshape(10, -1).sum(1).sort().values
    torch.testing.assert_close(seen, padded.y.reshape(10, -1).sum(1).sort().values)


def test_nothing_is_printed_but_the_bar(capfd):
    fit_anarx(TRAIN, VALID, SHAPE, options(max_iterations=2), progress=False)
    assert capfd.readouterr() == ("", "")
    fit_anarx(TRAIN, None, SHAPE, options(max_iterations=2), progress=True)
    shown = capfd.readouterr()
    assert shown.out == ""
    assert "Adam" in shown.err
    assert "lightning" not in shown.err.lower()
