"""Observations of RINEX: codes, units, events, and what was not received."""

import gzip
import math
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from navlearn.errors import ConfigError, LogError, MissingExtraError
from navlearn.logs.formats.rinex import RinexRanges
from navlearn.logs.formats.rinex_observations import read_observations

LIGHT = 299792458.0


def test_what_was_measured(files: Any, read: Callable[..., RinexRanges]) -> None:
    found = read()
    table = found.table
    np.testing.assert_array_equal(table["t"], files.OF_WEEK + np.repeat([0.0, 1.0], 4))
    assert list(table["satellite"][:4]) == list(files.SKY)
    np.testing.assert_array_equal(
        table["pseudorange"][4:], np.array(list(files.SKY.values())) + 10.0
    )
    np.testing.assert_array_equal(table["cn0"], 45.0)
    # a Doppler of −1 kHz moves apart by a thousand wavelengths; channel 5 of GLONASS
    carriers = np.array([1575.42e6, 1602e6 + 5 * 0.5625e6, 1575.42e6, 1561.098e6])
    np.testing.assert_allclose(table["range_rate"][:4], 1000.0 * LIGHT / carriers, rtol=1e-15)
    assert found.klobuchar == (1.5e-8, 2.2e-8, -1.2e-7, -1.2e-7, 1e5, 2e5, -6e4, -4e5)
    assert found.gps_time_origin == 2268 * 604800.0
    assert found.notes["codes"] == {"G": "C1C", "R": "C1C", "E": "C1X", "C": "C2I"}
    assert found.notes["receptions"] == 2


def test_a_preferred_code(files: Any, read: Callable[..., RinexRanges]) -> None:
    types = {"G": "C1C C1W D1C D1W S1C S1W"}
    receptions = [(files.NOON, {"G07": (21e6, 22e6, -10.0, -20.0, 40.0, 30.0)})]
    text = files.observations(receptions, types=types)
    assert read(text).table["pseudorange"][0] == 21e6
    other = read(text, codes={"G": ("C1W",)})
    assert other.table["pseudorange"][0] == 22e6
    assert other.table["cn0"][0] == 30.0
    assert other.table["range_rate"][0] == pytest.approx(20.0 * LIGHT / 1575.42e6)
    with pytest.raises(LogError, match=r"no pseudorange of a known code; its header names G C1C"):
        read(text, codes={"G": ("C1M",)})


def test_codes_of_other_carriers(files: Any, read: Callable[..., RinexRanges]) -> None:
    types = {"G": "C2X D2X S2X", "C": "C7I D7I S7I"}
    text = files.observations([(files.NOON, {"G07": (21e6, -10.0, 40.0)})], types=types)
    with pytest.raises(ConfigError, match=r"codes.G: found C2X; .* L1 or E1 \(C1C"):
        read(text, codes={"G": ("C1C", "C2X")})
    with pytest.raises(ConfigError, match=r"codes.C: found C7I; ranges are read of B1I"):
        read(text, codes={"C": ("C7I",)})


def test_observations_that_are_scaled(files: Any, read: Callable[..., RinexRanges]) -> None:
    plain, label = files.observations(files.usual()), "SYS / SCALE FACTOR"
    end = f"{'':60}END OF HEADER"
    same = plain.replace(end, f"{'G    1':60}{label}\n{end}")
    assert len(read(same).table) == len(read(plain).table)
    for lines in (["G  100"], ["G    1  1 L1C", "R   10  2 C1C D1C"]):
        told = "".join(f"{line:60}{label}\n" for line in lines)
        with pytest.raises(LogError, match=r"observations are scaled \(SYS / SCALE FACTOR"):
            read(plain.replace(end, told + end))


def test_what_was_not_received(files: Any, read: Callable[..., RinexRanges]) -> None:
    receptions = [
        (
            files.NOON,
            {
                "G07": (None, -1000.0, 40.0),
                "R03": (0.0, -1000.0, 40.0),
                "E11": (24e6, None, None),
                "C20": (23e6, -1000.0, 0.0),
                "S20": (23e6, -1000.0, 40.0),
                "J02": (23e6, -1000.0, 40.0),
            },
        )
    ]
    table = read(receptions).table
    assert list(table["satellite"]) == ["E11", "C20"]
    assert math.isnan(table["range_rate"][0])
    assert table["cn0"].isna().all()


def test_duplicates(files: Any, read: Callable[..., RinexRanges]) -> None:
    text = files.observations([files.usual(1)[0], files.usual(1)[0]])
    begin = text.index("> ")
    first = text[begin : text.index("> ", begin + 1)]
    twice = first.replace("  0  4", "  0  5") + f"G07{files.cells((99.0, 1.0, 1.0))}\n"
    found = read(text[:begin] + twice + first)
    assert len(found.table) == 4
    assert found.table["pseudorange"][0] == 21e6
    assert found.notes["receptions that came twice"] == 1
    assert found.notes["satellites that came twice in a reception"] == 1
    again = read(texts=[*files.messages(), *files.messages()])
    np.testing.assert_array_equal(again.table["sat_x"], read().table["sat_x"])


def test_events_are_skipped(files: Any, read: Callable[..., RinexRanges]) -> None:
    text = files.observations(files.usual())
    at = text.index("> ", text.index("> ") + 1)
    comment = f"{'antenna moved':<60}COMMENT\n"
    event = files.announced(files.NOON, 3, 2) + comment * 2
    found = read(text[:at] + event + text[at:])
    assert len(found.table) == 8
    assert found.notes["events"] == 1
    # an event without a time, as some receivers write it
    blank = f">{'':30}4  1\n{comment}"
    assert len(read(text[:at] + blank + text[at:]).table) == 8
    changed = f">{'':30}4  1\n{'G    1 C5Q':<60}SYS / # / OBS TYPES\n"
    with pytest.raises(LogError, match="observation types change in the middle; split it"):
        read(text[:at] + changed + text[at:])


def test_cut_off_at_the_end(files: Any, read: Callable[..., RinexRanges]) -> None:
    lines = files.observations(files.usual(3)).splitlines(keepends=True)
    found = read("".join(lines[:-2]))
    assert len(found.table) == 8
    assert found.notes["receptions cut off at the end"] == 1


def test_compressed_and_hatanaka(files: Any, tmp_path: Path) -> None:
    hatanaka = pytest.importorskip("hatanaka")
    plain = files.observations(files.usual())
    (tmp_path / "a.23o").write_text(plain)
    (tmp_path / "b.23o.gz").write_bytes(gzip.compress(plain.encode()))
    (tmp_path / "c.crx").write_text(hatanaka.rnx2crx(plain))
    tables = [read_observations(path).table for path in sorted(tmp_path.iterdir())]
    assert len(tables[0]) == 8
    for other in tables[1:]:
        assert other.equals(tables[0])
    packed = (tmp_path / "b.23o.gz").read_bytes()
    (tmp_path / "b.23o.gz").write_bytes(packed[: len(packed) // 2])
    with pytest.raises(LogError, match=r"b.23o.gz: not readable .* truncated"):
        read_observations(tmp_path / "b.23o.gz")


def test_without_the_library(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setitem(sys.modules, "georinex", None)
    with pytest.raises(MissingExtraError, match=r"georinex; pip install navlearn\[gnss\]"):
        read_observations(tmp_path / "day.obs")
