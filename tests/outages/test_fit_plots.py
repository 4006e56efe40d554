"""Residual tables, figures and words of a fit."""

import numpy as np
import pytest

from navlearn.errors import ConfigError, ShapeError
from navlearn.outages.fit_diagnostics import (
    AxisDiagnostics,
    FitDiagnostics,
    FusedPath,
    fit_section,
    residual_table,
)
from navlearn.outages.fit_plots import plot_fused_path, write_fit_diagnostics
from navlearn.outages.output import prepare_output_folder

ROWS = 400


def axis(name="x", seed=0, noise=2.0):
    rng = np.random.default_rng(seed)
    target = rng.normal(0.0, noise, ROWS)
    part = np.array(["training"] * 280 + ["validation"] * 60 + ["test"] * 50 + [""] * 10)
    return AxisDiagnostics(
        axis=name,
        target=target,
        predicted=np.full(ROWS, target[:280].mean()),
        unchanged=np.concatenate(([0.0], target[:-1])),
        part=part,
        at_fix=np.arange(ROWS) % 10 == 0,
    )


def path():
    t = np.arange(100) / 10.0
    truth = np.stack([t, 2.0 * t, -t], -1)
    return FusedPath(
        t=t, ins=truth + t[:, None] ** 2, fused=truth + 0.5, fix_t=t[::10], fix=truth[::10] + 1.0
    )


def fit(split="random", **changes):
    values = {"method": "jaradat2017", "loop": "open", "split": split}
    return FitDiagnostics(**{**values, "axes": (axis("x"), axis("y", 1), axis("z", 2)), **changes})


def test_mean_of_training_rows_is_zero_and_the_rms_is_not():
    table = residual_table([fit()]).set_index(["axis", "part", "rows"])
    row = table.loc["x", "training", "all"]
    assert abs(row["mean"]) < 1e-12
    assert row["rms"] == pytest.approx(axis().target[:280].std(), rel=1e-12)
    assert row["count"] == 280
    # A constant has no correlation with anything.
    assert np.isnan(row["r"])
    # White noise: what the row before tells is wrong by √2 as much.
    assert row["rms_unchanged"] == pytest.approx(np.sqrt(2.0) * row["rms"], rel=0.1)
    counts = [table.loc["x", "training", rows]["count"] for rows in ("at fixes", "between fixes")]
    assert counts == [28, 252]
    assert {part for _, part, _ in table.index} == {"training", "validation", "test"}


def test_correlation_is_that_of_numpy():
    one = axis()
    better = AxisDiagnostics(
        axis="x",
        target=one.target,
        predicted=0.9 * one.target + np.sin(np.arange(ROWS)),
        unchanged=one.unchanged,
        part=one.part,
    )
    table = residual_table([fit(axes=(better,))]).set_index("part")
    tested = slice(340, 390)
    wanted = np.corrcoef(better.target[tested], better.predicted[tested])[0, 1]
    assert table.loc["test", "r"] == pytest.approx(wanted, rel=1e-12)
    assert list(table["rows"]) == ["all"] * 3


def test_errors_in_use_need_a_truth():
    one = fit(path=path())
    assert "in use" not in set(residual_table([one])["part"])
    t = np.linspace(-1.0, 20.0, 50)
    known = one.with_truth(t, np.stack([t, 2.0 * t, -t], -1))
    table = residual_table([known]).set_index(["part", "axis"])
    assert table.loc[("in use", "y"), "rms"] == pytest.approx(0.5)
    ins = path().t ** 2
    assert table.loc[("ins alone", "x"), "mean"] == pytest.approx(ins.mean())
    assert fit().with_truth(t, np.zeros((50, 3))).path is None


def test_section_says_what_a_mean_hides_and_what_leaks():
    text = "\n".join(fit_section([fit()]))
    assert "whatever it predicts" in text
    assert "training figures" in text
    assert "1.82e-02 (y)" in text
    by_time = "\n".join(fit_section([fit(split="time", axes=(axis("along"),))]))
    assert "training figures" not in by_time
    assert "predecessor" not in by_time


def test_files_of_a_run(tmp_path):
    pytest.importorskip("matplotlib")
    output = prepare_output_folder(tmp_path / "run")
    shown = fit(path=path()).with_truth(path().t, path().ins)
    other = fit(method="ins_ekf+anarx", split="time", axes=(axis("along"), axis("cross", 5)))
    captions = write_fit_diagnostics(output, [shown, other])
    assert len(captions) == 5
    for name in captions:
        assert (output.path / name).read_bytes()[:4] == b"\x89PNG"
    lines = (output.path / "fit_residuals.csv").read_text(encoding="utf-8").splitlines()
    assert len(lines) == 1 + len(residual_table([shown, other]))
    with pytest.raises(ConfigError, match="no path to draw"):
        plot_fused_path(tmp_path / "a.png", other)


def test_rows_must_pair_up():
    one = axis()
    with pytest.raises(ShapeError, match="a value of each per row"):
        AxisDiagnostics(
            axis="x",
            target=one.target,
            predicted=one.predicted[:-1],
            unchanged=one.unchanged,
            part=one.part,
        )
