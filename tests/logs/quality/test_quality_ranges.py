"""Raw ranges: a sound log is left in peace, each mistake is found and named."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pandas as pd
import pytest

from navlearn.logs.drive_log import DriveLog
from navlearn.logs.quality import QualityReport, check_log
from navlearn.logs.quality.ranges import check_ranges
from navlearn.logs.synthetic import simulate_drive
from navlearn.logs.synthetic.satellite_options import SatelliteOptions

Change = Callable[[pd.DataFrame], pd.DataFrame]


@pytest.fixture(scope="module")
def ranged() -> DriveLog:
    """A drive with ranges of GPS and Galileo."""
    options = SatelliteOptions(systems="GE")
    return simulate_drive(duration=120.0, seed=12, imu_rate_hz=10.0, satellites=options).log


def found(log: DriveLog, change: Change) -> dict[str, str]:
    """Return topic and severity of what the check says of changed ranges."""
    part = check_ranges(replace(log, ranges=change(log.ranges.copy())))
    return {finding.topic: finding.severity for finding in part.findings}


def test_sound_ranges_are_left_in_peace(ranged: DriveLog) -> None:
    report = check_log(ranged)
    assert isinstance(report, QualityReport)
    assert not [f for f in report.findings if f.where.startswith("ranges")]
    figures = report.figures
    assert figures["receptions_solved_share"] == 1.0
    assert figures["receptions"] == ranged.ranges["t"].nunique()
    assert figures["satellites_per_reception"] == pytest.approx(
        len(ranged.ranges) / figures["receptions"], rel=0.05
    )
    assert figures["ranges_rate_hz"] == pytest.approx(1.0)
    assert figures["ranges_missing"] == 0.0
    assert figures["range_rate_scale"] == pytest.approx(1.0, abs=0.005)
    assert figures["single_point_error_median_m"] < 4.0
    assert figures["wild_ranges"] == 0.0
    assert report.to_text()


def test_a_log_without_ranges_is_not_asked_for_them(healthy: DriveLog) -> None:
    part = check_ranges(healthy)
    assert not part.findings
    assert not part.figures


def test_no_rows(ranged: DriveLog) -> None:
    assert found(ranged, lambda r: r.iloc[:0]) == {"empty table": "error"}


def test_gap_is_reported(ranged: DriveLog) -> None:
    ranges = ranged.ranges
    cut = ranges[(ranges["t"] < 40.0) | (ranges["t"] > 60.0)]
    report = check_log(replace(ranged, ranges=cut))
    gaps = report.gaps[report.gaps["table"] == "ranges"]
    assert gaps["length_s"].tolist() == pytest.approx([22.0], abs=2.0)


def _some_wild(ranges: pd.DataFrame) -> pd.DataFrame:
    ranges.loc[ranges.index[5::97], "pseudorange"] += 1e6
    return ranges


def _one_satellite_off(ranges: pd.DataFrame) -> pd.DataFrame:
    ranges.loc[ranges["satellite"] == _frequent(ranges), "pseudorange"] += 300.0
    return ranges


def _frequent(ranges: pd.DataFrame) -> str:
    return str(ranges["satellite"].value_counts().index[0])


def _jumps(ranges: pd.DataFrame) -> pd.DataFrame:
    ranges["pseudorange"] += 299792.458 * np.floor(ranges["t"] / 50.0)
    return ranges


def _often(ranges: pd.DataFrame) -> pd.DataFrame:
    ranges["pseudorange"] += 3e5 * np.sin(ranges["t"] ** 2)
    return ranges


def _twice(ranges: pd.DataFrame) -> pd.DataFrame:
    return pd.concat([ranges, ranges.iloc[[7]]]).sort_values("t", kind="stable")


def _scaled(ranges: pd.DataFrame, factor: float) -> pd.DataFrame:
    return ranges.assign(range_rate=factor * ranges["range_rate"])


def _noisy_rates(ranges: pd.DataFrame) -> pd.DataFrame:
    draw = np.random.default_rng(1)
    return ranges.assign(range_rate=ranges["range_rate"] + 30.0 * draw.standard_normal(len(ranges)))


def _swapped_axes(ranges: pd.DataFrame) -> pd.DataFrame:
    turned = ranges[["sat_y", "sat_z", "sat_x"]].to_numpy()
    return ranges.assign(sat_x=turned[:, 0], sat_y=turned[:, 1], sat_z=turned[:, 2])


def _noisy_pseudoranges(ranges: pd.DataFrame) -> pd.DataFrame:
    draw = np.random.default_rng(1)
    return ranges.assign(
        pseudorange=ranges["pseudorange"] + 1e5 * draw.standard_normal(len(ranges))
    )


@pytest.mark.parametrize(
    ("change", "topic", "severity"),
    [
        (_some_wild, "wild ranges", "warning"),
        (_one_satellite_off, "satellites refused", "warning"),
        (_jumps, "clock jumps", "info"),
        (_often, "clock jumps", "warning"),
        (_twice, "satellite twice", "error"),
        (lambda r: _scaled(r, -1.0), "range rate", "error"),
        (lambda r: _scaled(r, -5.255), "range rate", "error"),
        (lambda r: _scaled(r, 1.2), "range rate", "error"),
        (_noisy_rates, "range rate", "warning"),
        (_swapped_axes, "few positions from ranges", "error"),
        (_noisy_pseudoranges, "few positions from ranges", "error"),
        (lambda r: r.assign(satellite="7"), "ranges unusable", "error"),
        (lambda r: r.assign(cn0=(r["cn0"] / 6.0).round()), "signal strength", "warning"),
        (lambda r: r.assign(std_range=-r["std_range"]), "negative deviation", "warning"),
    ],
)
def test_each_mistake_is_named(ranged: DriveLog, change: Change, topic: str, severity: str) -> None:
    topics = found(ranged, change)
    assert topics.get(topic) == severity, topics


def test_satellite_at_fault_is_named_with_its_count(ranged: DriveLog) -> None:
    name = _frequent(ranged.ranges)
    part = check_ranges(replace(ranged, ranges=_one_satellite_off(ranged.ranges.copy())))
    refused = next(f for f in part.findings if f.topic == "satellites refused")
    assert f"{name} (" in refused.found
    assert refused.found.count("(") == 1


def test_size_and_count_of_wild_ranges(ranged: DriveLog) -> None:
    changed = _some_wild(ranged.ranges.copy())
    part = check_ranges(replace(ranged, ranges=changed))
    assert part.figures["wild_ranges"] == pytest.approx(len(changed.index[5::97]), abs=2)
    (wild,) = (f for f in part.findings if f.topic == "wild ranges")
    assert "by 1000.0 km" in wild.found


def test_clock_jumps_are_counted(ranged: DriveLog) -> None:
    part = check_ranges(replace(ranged, ranges=_jumps(ranged.ranges.copy())))
    assert part.figures["receiver_clock_jumps"] == 2.0
    (jumps,) = (f for f in part.findings if f.topic == "clock jumps")
    assert " 1 ms" in jumps.found


def test_missing_satellite_clocks_are_said(ranged: DriveLog) -> None:
    metadata = replace(ranged.metadata, range_corrections=("ionosphere", "troposphere"))
    ranges = ranged.ranges.drop(columns="sat_clock", errors="ignore")
    part = check_ranges(replace(ranged, ranges=ranges, metadata=metadata))
    assert [f.topic for f in part.findings] == ["ranges unusable"]
    assert "sat_clock" in part.findings[0].found


def test_ranges_of_another_hour_lie_beside_the_track(ranged: DriveLog) -> None:
    reference = ranged.reference.assign(lat=ranged.reference["lat"] + 0.001)
    topics = {f.topic for f in check_ranges(replace(ranged, reference=reference)).findings}
    assert topics == {"ranges beside the track"}


def test_without_range_rates(ranged: DriveLog) -> None:
    bare = ranged.ranges.drop(columns="range_rate")
    part = check_ranges(replace(ranged, ranges=bare))
    assert not part.findings
    assert "no range rate" in part.not_observable["range_rate_scale"]
