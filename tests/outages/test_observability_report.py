"""Records of observability: what is kept, drawn, tabled and said of a filter's run."""

import dataclasses
from pathlib import Path

import numpy as np
import pytest
import torch
from torch import Tensor

from navlearn.errors import LogError, OutputExistsError, ShapeError
from navlearn.filters.degree_of_observability import normalized_covariance
from navlearn.outages import observability_report
from navlearn.outages.observability_plots import state_groups
from navlearn.outages.observability_record import (
    ObservabilityRecord,
    observability_of_run,
    read_observability_csv,
    write_observability_csv,
)
from navlearn.outages.observability_report import (
    conclusions,
    observability_section,
    write_observability,
)
from navlearn.outages.observability_tables import Phase, direction_table, phases, state_table
from navlearn.outages.output import prepare_output_folder
from navlearn.outages.schedule import Outage

NAMES = ["east", "azimuth", "gyro_bias"]
UNITS = {"east": "m", "azimuth": "rad", "gyro_bias": "rad/s"}
START = torch.diag(torch.tensor([4.0, 0.01, 1e-6], dtype=torch.float64))
OUTAGES = [Outage(20.0, 10.0), Outage(50.0, 10.0)]
PNG = b"\x89PNG\r\n\x1a\n"


def covariances(t: Tensor) -> Tensor:
    """East is lost fast in outages, azimuth slowly with it; the gyro bias is never learned."""
    since = torch.zeros_like(t)
    for outage in OUTAGES:
        inside = (t >= outage.start) & (t <= outage.end)
        since = torch.where(inside, t - outage.start, since)
    P = START.repeat(len(t), 1, 1)
    P[:, 0, 0] = 1.0 + since**2
    P[:, 1, 1] = 1e-4 * (1.0 + 0.3 * since)
    P[:, 0, 1] = P[:, 1, 0] = 0.003 * torch.sqrt(since)
    P[:, 2, 2] *= 0.95
    after = (t >= 30.0) & (t < 30.5)  # the fix that ends the first outage
    P[after, :2, :2] = START[:2, :2] * 0.25
    return P


@pytest.fixture(scope="module")
def record() -> ObservabilityRecord:
    t = torch.arange(1.0, 81.0, dtype=torch.float64)
    still = ((t > 34.0) & (t < 47.0)) | (t < 3.0) | ((t > 50.0) & (t < 58.0))
    return observability_of_run(
        covariances(t), START, t, start_time=0.0, names=NAMES, units=UNITS, still=still
    )


def test_record_holds_what_the_covariance_says(record: ObservabilityRecord) -> None:
    assert record.t[0] == 0.0
    np.testing.assert_allclose(record.against_start[0], 1.0)
    np.testing.assert_allclose(record.eigenvalues[0], 1.0)
    k = record.row_at(28.4)
    assert record.t[k] == 28.0
    P = covariances(torch.tensor([28.0], dtype=torch.float64))
    expected = normalized_covariance(P, START)
    scaled = np.diag([0.5, 10.0, 1e3]) @ P[0].numpy() @ np.diag([0.5, 10.0, 1e3])
    np.testing.assert_allclose(record.against_start[k], np.diag(scaled))
    np.testing.assert_allclose(record.eigenvalues[k], np.linalg.eigvalsh(scaled))
    np.testing.assert_allclose(scaled @ record.least[k], record.eigenvalues[k, 2] * record.least[k])
    np.testing.assert_allclose(scaled @ record.best[k], record.eigenvalues[k, 0] * record.best[k])
    np.testing.assert_allclose(
        record.to_share[k] * record.against_start[k], expected.share[0].diagonal().numpy()
    )
    assert (record.row_at(-5.0), record.row_before(-5.0)) == (0, 0)
    assert (record.row_at(30.0), record.row_before(30.0), record.row_before(30.4)) == (30, 29, 30)
    assert record.row_at(1e6) == 80


def test_standstills_are_told_from_when_to_when(record: ObservabilityRecord) -> None:
    assert record.standstills() == [(0.0, 3.0), (35.0, 47.0), (51.0, 58.0)]
    ending = dataclasses.replace(record, still=record.t > 70.0)
    assert ending.standstills() == [(71.0, 80.0)]


def test_of_many_updates_one_a_second_is_kept_and_of_one_time_the_last() -> None:
    t = torch.tensor([0.1, 0.1, 0.2, 1.1, 1.1, 1.2, 2.3, 2.4], dtype=torch.float64)
    P = START * (1.0 + torch.arange(8.0, dtype=torch.float64))[:, None, None]
    found = observability_of_run(P, START, t, start_time=0.0, names=NAMES)
    np.testing.assert_allclose(found.t, [0.0, 1.1, 2.3, 2.4])
    np.testing.assert_allclose(found.against_start[:, 0], [1.0, 5.0, 7.0, 8.0])
    assert not found.still.any()
    assert state_groups(found) == {"variance": [0, 1, 2]}
    every = observability_of_run(P, START, t, start_time=0.0, names=NAMES, spacing=0.0)
    np.testing.assert_allclose(every.t, [0.0, 0.1, 0.2, 1.1, 1.2, 2.3, 2.4])


def test_what_is_known_exactly_at_the_start_is_left_out_and_named() -> None:
    t = torch.arange(1.0, 5.0, dtype=torch.float64)
    start = START.clone()
    start[1, 1] = 0.0
    found = observability_of_run(covariances(t), start, t, start_time=0.0, names=NAMES)
    assert found.names == ("east", "gyro_bias")
    assert found.known == ("azimuth",)
    assert found.sigma.shape == (5, 2)
    assert "known exactly at the start: azimuth" in "\n".join(observability_section(found, []))


def test_shapes_that_do_not_fit_are_refused() -> None:
    t = torch.arange(1.0, 5.0, dtype=torch.float64)
    with pytest.raises(ShapeError, match="of one drive"):
        observability_of_run(covariances(t), START, t[1:], start_time=0.0, names=NAMES)
    with pytest.raises(ShapeError, match="2 names"):
        observability_of_run(covariances(t), START, t, start_time=0.0, names=NAMES[:2])


def test_a_record_comes_back_from_its_file(record: ObservabilityRecord, tmp_path: Path) -> None:
    path = write_observability_csv(tmp_path / "observability.csv", record)
    back = read_observability_csv(path, units=UNITS)
    assert (back.names, back.units) == (record.names, record.units)
    for name in ("t", "sigma", "eigenvalues", "best", "least"):
        np.testing.assert_allclose(getattr(back, name), getattr(record, name), rtol=2e-5, atol=1e-9)
    np.testing.assert_array_equal(back.still, record.still)
    (tmp_path / "other.csv").write_text("t,speed\n0.0,1.0\n", encoding="utf-8")
    with pytest.raises(LogError, match=r"other\.csv: found the columns \['t', 'speed'\]"):
        read_observability_csv(tmp_path / "other.csv")


def test_phases_are_the_longest_free_standstill_the_outages_and_the_end(
    record: ObservabilityRecord,
) -> None:
    assert phases(record, OUTAGES) == [
        Phase(name="longest standstill", start=35.0, end=47.0),
        Phase(name="outage 1", start=20.0, end=30.0),
        Phase(name="outage 2", start=50.0, end=60.0),
        Phase(name="drive", start=80.0, end=80.0),
    ]
    moving = dataclasses.replace(record, still=np.zeros(81, dtype=bool))
    many = phases(moving, [Outage(float(k), 0.5) for k in range(5, 75)])
    assert [many[0].name, many[-2].name, len(many)] == ["outage 1", "outage 70", 9]
    assert [one.name for one in phases(moving, [])] == ["drive"]


def test_directions_are_named_at_start_middle_and_end(record: ObservabilityRecord) -> None:
    table = direction_table(record, phases(record, OUTAGES)[1:])
    assert list(zip(table["phase"], table["moment"], strict=True)) == [
        ("outage 1", "start"), ("outage 1", "middle"), ("outage 1", "end"),
        ("outage 2", "start"), ("outage 2", "middle"), ("outage 2", "end"),
        ("drive", "end"),
    ]  # fmt: skip
    start, end = table.iloc[0], table.iloc[2]
    assert start["least_direction"] == "gyro bias 1.00"
    assert start["best_direction"] == "azimuth 1.00"
    assert end["least_direction"].startswith("east 1.00")
    assert end["least_left"] == pytest.approx(np.sqrt(82.0 / 4.0), rel=1e-3)
    at_start = direction_table(record, [Phase(name="start", start=0.0, end=0.0)]).iloc[0]
    assert at_start["best_direction"] == at_start["least_direction"] == ""
    assert 0.0 < end["best_share"] < end["least_share"] < 3.0


def test_states_are_tabled_and_the_share_alone_is_not_believed(
    record: ObservabilityRecord,
) -> None:
    table = state_table(record, OUTAGES).set_index("state")
    azimuth = table.loc["azimuth"]
    assert azimuth["initial"] == pytest.approx(0.1)
    assert azimuth["least"] == pytest.approx(0.1)
    assert azimuth["outages_end"] == pytest.approx(0.1 * np.sqrt(3.7))
    assert azimuth["growth"] == pytest.approx(np.sqrt(3.7))
    assert azimuth["share_growth"] < 1.0
    assert table.loc["east", "growth"] == pytest.approx(np.sqrt(82.0))
    assert table.loc["gyro bias", "least"] == pytest.approx(np.sqrt(0.95))
    assert state_table(record, [])["outages_end"].isna().all()
    said = conclusions(record, OUTAGES)
    assert said[0].startswith("**Hardly observed on this drive**: gyro bias.")
    assert "east 9.1, azimuth 1.9, gyro bias 1.0" in said[1]
    assert "It is not better observed" in said[2]
    assert not any("accelerometer" in line for line in said)


def test_a_full_imu_is_told_of_its_accelerometers() -> None:
    names = ["east", "phi_up", "accel_bias_x"]
    t = torch.arange(1.0, 81.0, dtype=torch.float64)
    P = covariances(t)
    P[:, 2, 2] *= 0.5
    P[:, 1, 1] = 1e-4
    P[:, 0, 1] = P[:, 1, 0] = 0.0
    found = observability_of_run(P, START, t, start_time=0.0, names=names)
    said = conclusions(found, OUTAGES)
    assert said[0].startswith("**Every state** was told something")
    assert said[2].startswith(
        "**Azimuth (phi up)** through an outage (median): its deviation becomes 1.00"
    )
    assert "not better observed" not in said[2]
    assert "hide behind roll and pitch" in said[-1]
    assert len(conclusions(found, [])) == 3


def test_the_section_has_its_tables(record: ObservabilityRecord) -> None:
    text = "\n".join(observability_section(record, OUTAGES, whose="`ekf` on made"))
    for heading in ("## Degree of observability", "### Best and least", "### Every state"):
        assert f"\n{heading}" in text
    assert "Of `ekf` on made, from its own covariance" in text
    assert "| azimuth | 0.1 rad | 0.1 | 0.1 | 0.192 | 0.1 |" in text
    assert "| outage 1 | start | azimuth 1.00 | gyro bias 1.00 | 20.0 |" in text
    no_outages = "\n".join(observability_section(record, []))
    assert "| azimuth | 0.1 rad | 0.1 | 0.1 |" in no_outages
    assert "outages end" not in no_outages


def test_files_of_a_run_are_claimed_and_written(
    record: ObservabilityRecord, tmp_path: Path
) -> None:
    output = prepare_output_folder(tmp_path / "run")
    found = write_observability(output, record, OUTAGES, ending="_2", whose="`ekf`")
    assert sorted(found.figures) == [
        "observability_directions_2.png",
        "observability_eigenvalues_2.png",
        "observability_states_2.png",
    ]
    for name in found.figures:
        assert (output.path / name).read_bytes()[:8] == PNG
    assert read_observability_csv(output.path / "observability_2.csv").names == record.names
    assert found.section[0] == "\n## Degree of observability\n"
    (output.path / "observability.csv").write_text("mine", encoding="utf-8")
    with pytest.raises(OutputExistsError):
        write_observability(output, record, OUTAGES)


def test_without_matplotlib_the_tables_are_written(
    record: ObservabilityRecord, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(observability_report, "plots_possible", lambda: False)
    output = prepare_output_folder(tmp_path / "run")
    found = write_observability(output, record, OUTAGES)
    assert found.figures == {}
    assert (output.path / "observability.csv").exists()
    assert found.section


def test_states_of_one_unit_share_a_panel(record: ObservabilityRecord) -> None:
    scaled = dataclasses.replace(record, units={"east": "m", "azimuth": "rad", "gyro_bias": "1"})
    assert state_groups(scaled) == {"states in m": [0], "states in rad": [1], "factors": [2]}
