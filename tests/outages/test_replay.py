from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from navlearn.errors import ConfigError, FilterDivergedError, LogError, ShapeError
from navlearn.logs.drive_log import DriveLog
from navlearn.outages.known_log import known_log
from navlearn.outages.metrics import FIGURES
from navlearn.outages.replay import Solution, join_replays, replay
from navlearn.outages.schedule import Outage

MakeLog = Callable[..., DriveLog]
OUTAGES = (Outage(200.0, 60.0), Outage(300.0, 60.0), Outage(500.0, 30.0))


@dataclass
class Reckoner:
    """Dead reckoning on a sphere that uses all it is given: every fix and every sample."""

    yaw_error: float = 0.0
    calls: list[float] = field(default_factory=list)
    fail_at: float | None = None

    def predict(self, log: DriveLog, outage: Outage) -> Solution:
        self.calls.append(outage.start)
        if outage.start == self.fail_at:
            raise FilterDivergedError("the covariance is not finite")
        last = log.fixes.iloc[-1]
        step = log.odometer[log.odometer["t"] >= last["t"]]
        t = step["t"].to_numpy()
        rate = np.interp(t, log.imu["t"], -log.imu["gyro_z"])
        start = np.arctan2(last["v_e"], last["v_n"])
        azimuth = start + np.concatenate(([0.0], np.cumsum(rate[1:] * np.diff(t))))
        azimuth = azimuth + self.yaw_error
        v_e, v_n = step["speed"] * np.sin(azimuth), step["speed"] * np.cos(azimuth)
        # The mean of all fixes enters too, so that no fix can change unnoticed.
        spread = 1e-12 * float(log.fixes[["lat", "lon"]].to_numpy().sum())
        dt = np.diff(t, prepend=t[0])
        lat = last["lat"] + np.cumsum(v_n * dt) / 6.36e6 + spread
        lon = last["lon"] + np.cumsum(v_e * dt) / (6.386e6 * np.cos(lat)) + spread
        table = pd.DataFrame({"t": t, "lat": lat, "lon": lon, "height": 100.0})
        table = table.assign(v_e=v_e.to_numpy(), v_n=v_n.to_numpy(), azimuth=azimuth)
        return Solution(table=table, notes={"fixes": len(log.fixes), "scale": np.float64(1.5)})


@dataclass
class BatchReckoner(Reckoner):
    batches: int = 0

    def predict_many(self, logs: Sequence[DriveLog], outages: Sequence[Outage]) -> list[Solution]:
        self.batches += 1
        return [self.predict(log, one) for log, one in zip(logs, outages, strict=True)]


@pytest.fixture(scope="module")
def log(make_log: MakeLog) -> DriveLog:
    return make_log(duration=600.0, azimuth=lambda t: 0.5 + 0.3 * np.sin(t / 20.0))


def poisoned(table: pd.DataFrame, rows: "pd.Series[bool]") -> pd.DataFrame:
    columns = [name for name in table.columns if name != "t"]
    table = table.copy()
    table.loc[rows, columns] = 1e3
    return table


def test_known_log_ends_with_the_outage_and_has_no_later_fix(log: DriveLog) -> None:
    known = known_log(log, OUTAGES[0])
    assert known.fixes["t"].max() == 199.0  # the fix at 200 s is already gone
    assert known.imu["t"].max() == known.odometer["t"].max() == 260.0
    assert known.reference is None
    assert len(known.fixes) == 200


def test_post_processing_sees_what_comes_after_the_outage_and_nothing_inside(
    log: DriveLog,
) -> None:
    outage = OUTAGES[0]
    known = known_log(log, outage, after=30.0)
    assert known.reference is None
    t = known.fixes["t"]
    assert not t.between(200.0, 260.0, inclusive="left").any()
    assert list(t[t > 199.0]) == [float(k) for k in range(260, 291)]
    assert known.imu["t"].max() == known.odometer["t"].max() == 290.0
    rest = known_log(log, outage, after=float("inf"))
    assert rest.fixes["t"].max() == log.fixes["t"].max()
    pd.testing.assert_frame_equal(rest.imu, log.imu)


@dataclass
class Hindsight(BatchReckoner):
    """Uses its last fix before the outage, and the sum of all that it is given."""

    sees_after: float = 40.0

    def predict(self, log: DriveLog, outage: Outage) -> Solution:
        causal = replace(log, fixes=log.fixes[log.fixes["t"] < outage.start])
        made = super().predict(causal, outage)
        every = float(log.fixes["lat"].sum()) * 1e-12
        table = made.table[made.table["t"] <= outage.end]
        return Solution(table=table.assign(lat=table["lat"] + every), notes={"seen": every})


@pytest.mark.parametrize("batched", [False, True])
def test_only_what_says_so_is_shown_what_comes_after(log: DriveLog, batched: bool) -> None:
    outage = OUTAGES[0]
    methods = {"real_time": BatchReckoner(), "hindsight": Hindsight()}

    def moved_by(first: float, last: float) -> dict[str, bool]:
        rows = (log.fixes["t"] >= first) & (log.fixes["t"] <= last)
        spoilt = replace(log, fixes=poisoned(log.fixes, rows))
        clean, again = (
            replay(one, [outage], methods, progress=False, batched=batched) for one in (log, spoilt)
        )
        return {
            name: not again.solutions[name, 1].table.equals(clean.solutions[name, 1].table)
            for name in methods
        }

    assert moved_by(200.0, 259.9) == {"real_time": False, "hindsight": False}
    assert moved_by(260.0, 260.0) == {"real_time": False, "hindsight": True}
    assert moved_by(300.0, 300.0) == {"real_time": False, "hindsight": True}
    assert moved_by(300.1, 600.0) == {"real_time": False, "hindsight": False}
    assert moved_by(150.0, 150.0) == {"real_time": True, "hindsight": True}


def test_what_a_method_sees_is_part_of_what_is_stored(log: DriveLog, tmp_path: Path) -> None:
    run(log, Hindsight(), tmp_path, {})
    same, other = Hindsight(), Hindsight(sees_after=50.0)
    run(log, same, tmp_path, {})
    assert same.calls == []
    run(log, other, tmp_path, {})
    assert len(other.calls) == 3
    causal = Reckoner()
    run(log, causal, tmp_path, {})
    assert len(causal.calls) == 3


def test_a_method_cannot_see_less_than_the_outage(log: DriveLog) -> None:
    with pytest.raises(ConfigError, match=r"Hindsight.sees_after: found -1\.0"):
        replay(log, OUTAGES, {"m": Hindsight(sees_after=-1.0)}, progress=False)


def test_every_table_of_a_log_has_a_rule() -> None:
    """A table added to DriveLog needs a decision in known_log about what it may show."""
    names = {one.name for one in fields(DriveLog)}
    assert names == {"imu", "odometer", "fixes", "reference", "metadata", "ranges"}


@pytest.mark.parametrize("batched", [False, True])
def test_no_output_moves_when_what_must_not_be_seen_is_poisoned(
    log: DriveLog, batched: bool
) -> None:
    method = {"m": BatchReckoner()}
    clean = replay(log, OUTAGES, method, progress=False, batched=batched)
    for number, outage in enumerate(OUTAGES, start=1):
        assert log.reference is not None
        spoilt = replace(
            log,
            fixes=poisoned(log.fixes, log.fixes["t"] >= outage.start),
            reference=poisoned(log.reference, log.reference["t"] >= 0.0),
            imu=poisoned(log.imu, log.imu["t"] > outage.end),
            odometer=poisoned(log.odometer, log.odometer["t"] > outage.end),
        )
        again = replay(spoilt, [outage], method, progress=False, batched=batched)
        pd.testing.assert_frame_equal(
            again.solutions["m", 1].table, clean.solutions["m", number].table, check_exact=True
        )


def test_the_poison_would_show(log: DriveLog) -> None:
    """The toy method does react to a fix before the outage and to a sample within it."""
    clean = Reckoner().predict(known_log(log, OUTAGES[0]), OUTAGES[0]).table
    for name, time in (("fixes", 50.0), ("imu", 230.0), ("odometer", 230.0)):
        table = getattr(log, name)
        spoilt = replace(log, **{name: poisoned(table, table["t"] == time)})
        moved = Reckoner().predict(known_log(spoilt, OUTAGES[0]), OUTAGES[0]).table
        assert not moved.equals(clean), name


def test_rows_have_the_promised_columns_in_order(log: DriveLog) -> None:
    rows = replay(log, OUTAGES, {"a": Reckoner(), "b": Reckoner(0.05)}, progress=False).rows
    assert list(rows["method"]) == ["a"] * 3 + ["b"] * 3
    assert list(rows["outage"]) == [1, 2, 3] * 2
    assert list(rows["start_s"]) == [200.0, 300.0, 500.0] * 2
    assert set(FIGURES) <= set(rows.columns)
    assert (rows["failure"] == "").all()
    assert rows["distance_m"].to_numpy() == pytest.approx([600.0, 600.0, 300.0] * 2)
    by_method = rows.groupby("method")["max_horizontal_error_m"].max()
    assert by_method["a"] < 3.0
    assert by_method["b"] == pytest.approx(0.05 * 600.0, rel=0.15)


def test_batch_equals_one_by_one(log: DriveLog) -> None:
    method = BatchReckoner(0.02)
    one = replay(log, OUTAGES, {"m": method}, progress=False)
    assert method.batches == 0
    many = replay(log, OUTAGES, {"m": method}, progress=False, batched=True)
    assert method.batches == 1
    pd.testing.assert_frame_equal(one.rows, many.rows, check_exact=True)


def test_an_outage_that_fails_is_told_and_the_others_go_on(log: DriveLog) -> None:
    for batched in (False, True):
        method = BatchReckoner(fail_at=300.0)
        found = replay(log, OUTAGES, {"m": method}, progress=False, batched=batched)
        assert list(found.rows["failure"]) == ["", "the covariance is not finite", ""]
        assert found.rows["max_horizontal_error_m"].isna().tolist() == [False, True, False]
        assert ("m", 2) not in found.solutions


def test_when_all_fail_the_columns_are_still_there(log: DriveLog) -> None:
    found = replay(log, OUTAGES[:1], {"m": Reckoner(fail_at=200.0)}, progress=False)
    known = ["distance_m", "turned_deg"]  # these are the road's
    assert found.rows[[name for name in FIGURES if name not in known]].isna().all(axis=None)
    assert found.rows["distance_m"].iloc[0] == pytest.approx(600.0)


def test_a_wrong_solution_is_an_error_not_a_failure(log: DriveLog) -> None:
    class Wrong:
        def predict(self, log: DriveLog, outage: Outage) -> Solution:
            return Solution(table=pd.DataFrame({"t": [0.0]}))

    with pytest.raises(ShapeError, match="missing columns"):
        replay(log, OUTAGES, {"m": Wrong()}, progress=False)


def test_wrong_requests_are_refused(log: DriveLog) -> None:
    with pytest.raises(ConfigError, match="0 methods"):
        replay(log, OUTAGES, {}, progress=False)
    with pytest.raises(ConfigError, match="overlaps"):
        replay(log, [OUTAGES[0], OUTAGES[0]], {"m": Reckoner()}, progress=False)
    with pytest.raises(LogError, match="from 590 to 650 s lies outside the log"):
        replay(log, [Outage(590.0, 60.0)], {"m": Reckoner()}, progress=False)


def run(
    log: DriveLog, method: Reckoner, store: Path, settings: Mapping[str, object]
) -> pd.DataFrame:
    done = replay(
        log, OUTAGES, {"m": method}, store=store, settings={"m": settings}, progress=False
    )
    return done.rows


def test_an_interrupted_run_goes_on_where_it_stopped(log: DriveLog, tmp_path: Path) -> None:
    class Interrupted(Reckoner):
        def predict(self, log: DriveLog, outage: Outage) -> Solution:
            if outage.start == 500.0:
                raise KeyboardInterrupt
            return super().predict(log, outage)

    options = {"yaw_error": 0.01}
    with pytest.raises(KeyboardInterrupt):
        run(log, Interrupted(0.01), tmp_path, options)
    second = Reckoner(0.01)
    rows = run(log, second, tmp_path, options)
    assert second.calls == [500.0]
    whole = replay(log, OUTAGES, {"m": Reckoner(0.01)}, progress=False)
    pd.testing.assert_frame_equal(rows, whole.rows, check_exact=True)
    third = Reckoner(0.01)
    again = replay(
        log, OUTAGES, {"m": third}, store=tmp_path, settings={"m": options}, progress=False
    )
    assert third.calls == []
    for key, solution in whole.solutions.items():
        pd.testing.assert_frame_equal(again.solutions[key].table, solution.table, check_exact=True)
        assert again.solutions[key].notes == solution.notes


def test_a_changed_setting_or_log_or_outage_makes_the_store_void(
    log: DriveLog, tmp_path: Path
) -> None:
    run(log, Reckoner(), tmp_path, {"lags": 3})
    changed_setting = Reckoner()
    run(log, changed_setting, tmp_path, {"lags": 4})
    assert len(changed_setting.calls) == 3
    imu = log.imu.copy()
    imu.loc[17, "gyro_z"] += 1e-9
    changed_log = Reckoner()
    run(replace(log, imu=imu), changed_log, tmp_path, {"lags": 3})
    assert len(changed_log.calls) == 3
    same = Reckoner()
    run(log, same, tmp_path, {"lags": 3})
    assert same.calls == []


def test_a_store_needs_settings_that_are_plain(log: DriveLog, tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match=r"no settings for \['m'\]"):
        replay(log, OUTAGES, {"m": Reckoner()}, store=tmp_path, progress=False)
    with pytest.raises(ConfigError, match=r"type Path is not plain|type PosixPath is not plain"):
        run(log, Reckoner(), tmp_path, {"where": tmp_path})


def test_drives_are_joined_under_their_own_names(make_log: MakeLog) -> None:
    found = [
        replay(make_log(duration=300.0, name=name), OUTAGES[:1], {"m": Reckoner()}, progress=False)
        for name in ("one", "two")
    ]
    assert list(join_replays(found)["drive"]) == ["one", "two"]
    with pytest.raises(ConfigError, match=r"\['one'\] come twice"):
        join_replays([found[0], found[0]])


def test_the_log_handed_over_is_a_copy(log: DriveLog) -> None:
    class Vandal(Reckoner):
        def predict(self, log: DriveLog, outage: Outage) -> Solution:
            made = super().predict(log, outage)
            for table in log.tables().values():
                table.loc[:, :] = -1.0
            return made

    before = {name: table.copy() for name, table in log.tables().items()}
    replay(log, OUTAGES, {"m": Vandal()}, progress=False)
    for name, table in log.tables().items():
        pd.testing.assert_frame_equal(table, before[name])
