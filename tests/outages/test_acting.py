import io

import pandas as pd
import pytest

from navlearn.outages.acting import Acting, acting, reasons, safeguard_section, verdict_columns

GATE = "gate: {gain:+.1f} % on {count} emulated outages, at least 5.0 % asked"


def rows() -> pd.DataFrame:
    """Four outages: the filter learns nothing, a net acts twice, a ridge cannot be fitted once."""
    made = [{"method": "ekf", "outage": k, **verdict_columns({})} for k in range(4)]
    for k, gain in enumerate((12.0, -3.5, 31.0, -0.25)):
        notes = {"used": gain > 5.0, "reason": GATE.format(gain=gain, count=30 + k)}
        made.append({"method": "net", "outage": k, **verdict_columns(notes)})
    for k in range(3):
        notes = {"used": True, "reason": "5 terms"}
        made.append({"method": "ridge", "outage": k, **verdict_columns(notes)})
    lost = verdict_columns({"used": False, "reason": "no fix after x1"})
    return pd.DataFrame([*made, {"method": "ridge", "outage": 3, **lost}])


def from_csv(table: pd.DataFrame) -> pd.DataFrame:
    return pd.read_csv(io.StringIO(table.to_csv(index=False)))


@pytest.mark.parametrize("table", [rows(), from_csv(rows())], ids=["fresh", "read back"])
def test_verdicts_are_counted_for_methods_that_learn(table: pd.DataFrame) -> None:
    assert acting(table, "net") == Acting(acted=2, asked=4)
    assert acting(table, "ridge") == Acting(acted=3, asked=4)
    assert acting(table, "ekf") is None


@pytest.mark.parametrize("table", [rows(), from_csv(rows())], ids=["fresh", "read back"])
def test_reasons_that_differ_in_figures_are_one(table: pd.DataFrame) -> None:
    found = reasons(table, ["ekf", "ridge", "net"])
    assert found.to_numpy().tolist() == [
        ["ridge", True, 3, "5 terms"],
        ["ridge", False, 1, "no fix after x1"],
        [
            "net",
            True,
            2,
            "gate: +12.0 to +31.0 % on 30 to 32 emulated outages, at least 5.0 % asked",
        ],
        [
            "net",
            False,
            2,
            "gate: -3.5 to -0.2 % on 31 to 33 emulated outages, at least 5.0 % asked",
        ],
    ]


def test_figures_that_are_not_known_leave_their_range_to_the_others() -> None:
    notes = [{"used": False, "reason": f"gate: {gain} %"} for gain in ("nan", "−2.0", "nan")]
    table = pd.DataFrame([{"method": "net", **verdict_columns(one)} for one in notes])
    assert reasons(table, ["net"])["reason"].tolist() == ["gate: −2.0 %"]
    assert reasons(table[::2], ["net"])["reason"].tolist() == ["gate: nan %"]


def test_the_section_is_there_only_where_somebody_learns() -> None:
    text = "\n".join(safeguard_section(rows(), ["ekf", "net"]))
    assert "| --- | --- | --- | ---: |" in text
    assert "| net | acted | gate: +12.0 to +31.0 % on 30 to 32 emulated outages" in text
    assert "| net | stood back | gate: -3.5 to -0.2 %" in text
    assert text.count(" asked | 2 |") == 2
    assert safeguard_section(rows(), ["ekf"]) == []
    old = rows().drop(columns=["used", "reason"])
    assert safeguard_section(old, ["net"]) == []
    assert acting(old, "net") is None
