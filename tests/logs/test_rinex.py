"""RINEX: small files made for each quirk of observations and navigation, versions 2 and 3."""

import gzip
import math
import random
import sys
import warnings
from collections.abc import Callable, Sequence
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from scipy.optimize import brentq

from navlearn.errors import ConfigError, LogError, MissingExtraError
from navlearn.gnss.glonass import glonass_state
from navlearn.gnss.kepler import kepler_state
from navlearn.logs.formats.rinex import RinexRanges, read_rinex
from navlearn.logs.formats.rinex_navigation import read_navigation
from navlearn.logs.formats.rinex_observations import read_observations
from navlearn.logs.formats.rinex_orbits import glonass_ephemeris, kepler_ephemeris
from navlearn.logs.reading import read_log

georinex = pytest.importorskip("georinex")

LIGHT = 299792458.0
NOON = datetime(2023, 6, 29, 12, 0, 0)  # GPS time, Thursday of week 2268
OF_WEEK = 4 * 86400.0 + 12 * 3600.0
CLOCK = datetime(2023, 6, 24, 23, 59, 42, tzinfo=UTC)  # where GPS week 2268 began
TYPES = {"G": "C1C D1C S1C", "R": "C1C D1C S1C", "E": "C1X D1X S1X", "C": "C2I D2I S2I"}
SKY = {"G07": 21e6, "R03": 20e6, "E11": 24e6, "C20": 23e6}

Values = Sequence[float | str | None]
Reception = tuple[datetime, dict[str, Values]]


def header(version: str, kind: str, lines: Sequence[tuple[str, str]]) -> str:
    first = f"{version:>9}{'':11}{kind:<20}{'M':<20}RINEX VERSION / TYPE"
    return "\n".join([first, *(f"{text:<60}{label}" for text, label in lines), ""])


def cells(values: Values) -> str:
    """Return observations of 14.3, each with two empty columns for its flags."""
    told = (f"{v:14.3f}" if isinstance(v, float | int) else f"{v or '':>14}" for v in values)
    return "".join(f"{text}  " for text in told).rstrip()


def observations(
    receptions: Sequence[Reception], *, system: str = "GPS", types: dict[str, str] = TYPES
) -> str:
    """Return an observation file of version 3.03."""
    lines = [
        *((f"{k}  {len(v.split()):3d} {v}", "SYS / # / OBS TYPES") for k, v in types.items()),
        (f"{'  2023     6    29    12     0    0.0000000':<48}{system}", "TIME OF FIRST OBS"),
        ("", "END OF HEADER"),
    ]
    text = header("3.03", "OBSERVATION DATA", lines)
    for time, satellites in receptions:
        text += announced(time, 0, len(satellites))
        text += "".join(f"{name}{cells(values)}\n" for name, values in satellites.items())
    return text


def announced(time: datetime, flag: int, count: int) -> str:
    seconds = time.second + time.microsecond * 1e-6
    return f"> {time:%Y %m %d %H %M}{seconds:11.7f}  {flag}{count:3d}\n"


def usual(count: int = 2, start: datetime = NOON) -> list[Reception]:
    """Return receptions a second apart, of a satellite of each constellation."""
    return [
        (
            start + timedelta(seconds=k),
            {name: (r + 10.0 * k, -1000.0, 45.0) for name, r in SKY.items()},
        )
        for k in range(count)
    ]


def number(value: float) -> str:
    return f"{value:19.12E}"


def message(name: str, toc: datetime, toe: float, **changed: float) -> str:
    """Return a Keplerian message of version 3: a plausible orbit, different for each satellite."""
    told = {
        "bias": 1e-4,
        "drift": 2e-12,
        "m0": 0.1 * int(name[1:]),
        "e": 0.01,
        "week": 912.0 if name[0] == "C" else 2268.0,
        "source": 513.0 if name[0] == "E" else 1.0,
        "health": 0.0,
        "delay": -1.1e-8,
        "delay_2": 3e-9,
    } | changed
    axis = 5282.6 if name[0] == "C" else 5440.6 if name[0] == "E" else 5153.7
    rows = [
        [5.0, -45.0, 4.6e-9, told["m0"]],
        [1.2e-6, told["e"], 8.8e-6, axis],
        [toe, 1.1e-7, 2.2, -6e-8],
        [0.96, 210.0, -1.1, -8.1e-9],
        [2e-10, told["source"], told["week"], 0.0],
        [2.0, told["health"], told["delay"], told["delay_2"]],
        [toe - 7200.0, 4.0],
    ]
    first = "".join(map(number, (told["bias"], told["drift"], 0.0)))
    text = f"{name} {toc:%Y %m %d %H %M %S}{first}\n"
    return text + "".join(" " * 4 + "".join(map(number, row)) + "\n" for row in rows)


def state_message(name: str, utc: datetime, *, health: float = 0.0, channel: float = 5.0) -> str:
    rows = [
        [10541.1572266, 0.321145057678, 2.79396772385e-9, health],
        [363.174316406, 3.16727161407, -1.86264514923e-9, channel],
        [23234.1108398, -0.191012382507, -9.31322574615e-10, 0.0],
    ]
    first = "".join(map(number, (8.9e-5, 1.8e-12, 385890.0)))
    text = f"{name} {utc:%Y %m %d %H %M %S}{first}\n"
    return text + "".join(" " * 4 + "".join(map(number, row)) + "\n" for row in rows)


def messages(**changed: float) -> list[str]:
    beidou = {key: value for key, value in changed.items() if key != "week"}
    return [
        message("G07", NOON, OF_WEEK, **changed),
        message("E11", NOON - timedelta(minutes=10), OF_WEEK - 600.0, **changed),
        message("C20", NOON, OF_WEEK, **beidou),
        state_message("R03", NOON - timedelta(minutes=15)),
    ]


def navigation(texts: Sequence[str], version: str = "3.03") -> str:
    lines = [
        (
            "GPSA " + "".join(f"{v:12.4E}" for v in (1.5e-8, 2.2e-8, -1.2e-7, -1.2e-7)),
            "IONOSPHERIC CORR",
        ),
        ("GPSB " + "".join(f"{v:12.4E}" for v in (1e5, 2e5, -6e4, -4e5)), "IONOSPHERIC CORR"),
        ("    18", "LEAP SECONDS"),
        ("", "END OF HEADER"),
    ]
    return header(version, "N: GNSS NAV DATA", lines) + "".join(texts)


@pytest.fixture
def read(tmp_path: Path) -> Callable[..., RinexRanges]:
    def made(
        receptions: Sequence[Reception] | str | None = None,
        texts: Sequence[str] | str | None = None,
        **options: Any,
    ) -> RinexRanges:
        observed = usual() if receptions is None else receptions
        told = messages() if texts is None else texts
        (tmp_path / "day.obs").write_text(
            observed if isinstance(observed, str) else observations(observed)
        )
        (tmp_path / "day.nav").write_text(told if isinstance(told, str) else navigation(told))
        options.setdefault("clock_start", CLOCK)
        return read_rinex(tmp_path / "day.obs", [tmp_path / "day.nav"], **options)

    return made


def test_what_was_measured(read: Callable[..., RinexRanges]) -> None:
    found = read()
    table = found.table
    np.testing.assert_array_equal(table["t"], OF_WEEK + np.repeat([0.0, 1.0], 4))
    assert list(table["satellite"][:4]) == list(SKY)
    np.testing.assert_array_equal(table["pseudorange"][4:], np.array(list(SKY.values())) + 10.0)
    np.testing.assert_array_equal(table["cn0"], 45.0)
    # a Doppler of −1 kHz moves apart by a thousand wavelengths; channel 5 of GLONASS
    carriers = np.array([1575.42e6, 1602e6 + 5 * 0.5625e6, 1575.42e6, 1561.098e6])
    np.testing.assert_allclose(table["range_rate"][:4], 1000.0 * LIGHT / carriers, rtol=1e-15)
    assert found.klobuchar == (1.5e-8, 2.2e-8, -1.2e-7, -1.2e-7, 1e5, 2e5, -6e4, -4e5)
    assert found.gps_time_origin == 2268 * 604800.0
    assert found.notes["codes"] == {"G": "C1C", "R": "C1C", "E": "C1X", "C": "C2I"}
    assert found.notes["receptions"] == 2


def test_satellites_when_they_sent(read: Callable[..., RinexRanges], tmp_path: Path) -> None:
    """The moment of sending by a root finder: by its own clock it is reception less travel."""
    table = read().table
    told = read_navigation([tmp_path / "day.nav"], 2268, (OF_WEEK, OF_WEEK), "GREC")
    for row in table.itertuples():
        orbit = told.orbits[told.orbits["satellite"] == row.satellite]
        state = told.states[told.states["satellite"] == row.satellite]

        def at(t: float, orbit: Any = orbit, state: Any = state) -> Any:
            time = torch.tensor([t], dtype=torch.float64)
            if len(orbit):
                return kepler_state(kepler_ephemeris(orbit), time)
            return glonass_state(glonass_ephemeris(state), time)

        stamp = row.t - row.pseudorange / LIGHT

        def early(t: float, at: Any = at, stamp: float = stamp) -> float:
            return t + float(at(t).clock) / LIGHT - stamp

        sent = brentq(early, stamp - 0.01, stamp + 0.01, xtol=1e-13)
        expected = at(sent)
        np.testing.assert_allclose(
            [row.sat_x, row.sat_y, row.sat_z], expected.position[0].numpy(), atol=1e-5, rtol=0
        )
        np.testing.assert_allclose(
            [row.sat_vx, row.sat_vy, row.sat_vz], expected.velocity[0].numpy(), atol=1e-8, rtol=0
        )
        assert row.sat_clock == pytest.approx(float(expected.clock[0]), abs=1e-9)
        assert row.sat_clock_rate == pytest.approx(float(expected.clock_rate[0]), abs=1e-12)


def test_qzss_is_read_as_gps(read: Callable[..., RinexRanges]) -> None:
    """The same numbers give the same orbit; the last bit of its health is of another signal."""
    types = {"G": "C1C D1C S1C", "J": "C1C D1C S1C"}
    both = [(NOON, {name: (36e6, -500.0, 40.0) for name in ("G02", "J02")})]
    texts = [message(name, NOON, OF_WEEK, health=h) for name, h in (("G02", 0.0), ("J02", 1.0))]
    table = read(observations(both, types=types), texts).table
    assert list(table["satellite"]) == ["G02", "J02"]
    for column in table.columns.drop(["t", "satellite"]):
        assert table[column][0] == table[column][1], column


def test_the_group_delay_of_the_code_that_was_measured(read: Callable[..., RinexRanges]) -> None:
    plain = read(texts=messages(delay=0.0, delay_2=0.0)).table["sat_clock"][:4]
    late = read(texts=messages(delay=1e-8, delay_2=3e-8)).table["sat_clock"][:4]
    # T_GD of GPS, none of GLONASS, BGD(E1, E5b) of I/NAV, T_GD1 of BeiDou
    expected = -LIGHT * np.array([1e-8, 0.0, 3e-8, 1e-8])
    np.testing.assert_allclose(late - plain, expected, atol=1e-6)


def test_the_message_of_the_signal_itself_comes_first(read: Callable[..., RinexRanges]) -> None:
    by_e5a = message("E11", NOON - timedelta(minutes=10), OF_WEEK - 600.0, source=258.0, bias=2e-4)
    both = read(texts=[by_e5a, *messages()]).table
    np.testing.assert_allclose(both["sat_clock"], read().table["sat_clock"])
    alone = read(texts=[by_e5a, *(m for m in messages() if not m.startswith("E"))]).table
    difference = alone["sat_clock"][2] - both["sat_clock"][2]
    assert difference == pytest.approx(LIGHT * (1e-4 + 1.1e-8 + 3e-9), abs=1e-3)


def test_the_nearest_message_counts(read: Callable[..., RinexRanges]) -> None:
    hours = [message("G07", NOON + timedelta(hours=h), OF_WEEK + 3600.0 * h, bias=1e-5 * (h + 3))
             for h in (-2, 0, 2)]  # fmt: skip
    start = NOON + timedelta(minutes=59, seconds=58, microseconds=500000)
    table = read(
        [(start + timedelta(seconds=k), {"G07": (21e6, 0.0, 40.0)}) for k in range(4)], hours
    ).table
    biases = np.round(table["sat_clock"] / LIGHT * 1e5)
    np.testing.assert_array_equal(biases, [3.0, 3.0, 5.0, 5.0])


def test_satellites_without_a_usable_orbit(read: Callable[..., RinexRanges]) -> None:
    told = [
        message("G07", NOON, OF_WEEK),
        message("E11", NOON - timedelta(hours=5), OF_WEEK - 5 * 3600.0),
        message("C20", NOON, OF_WEEK, health=1.0),
    ]
    with pytest.warns(
        UserWarning,
        match=r"day\.obs: 6 of 8 ranges are left out .* in day\.nav \(no orbit: R03; orbit too old "
        r"or too new: E11; unhealthy: C20\); a navigation file of the whole day",
    ):
        found = read(texts=told)
    assert set(found.table["satellite"]) == {"G07"}
    assert found.notes["left out"] == {
        "no orbit": {"R03": 2},
        "orbit too old or too new": {"E11": 2},
        "unhealthy": {"C20": 2},
    }


def test_an_unhealthy_satellite_is_no_reason_to_warn(read: Callable[..., RinexRanges]) -> None:
    told = [m for m in messages() if not m.startswith("R")]
    found = read(texts=[*told, state_message("R03", NOON, health=1.0)])
    assert found.notes["left out"] == {"unhealthy": {"R03": 2}}
    assert "R03" not in set(found.table["satellite"])


@pytest.mark.parametrize(("bits", "healthy"), [(0.0, True), (1.0, False), (4.0, False), (8, True)])
def test_galileo_is_healthy_where_e1_is(
    read: Callable[..., RinexRanges], bits: float, healthy: bool
) -> None:
    told = [m for m in messages() if not m.startswith("E")]
    found = read(texts=[*told, message("E11", NOON, OF_WEEK, health=bits)])
    assert ("E11" in set(found.table["satellite"])) == healthy


def test_no_orbit_at_all(read: Callable[..., RinexRanges]) -> None:
    with pytest.raises(
        LogError, match=r"day.obs: no satellite has a usable orbit in day.nav \(no orbit: C20, E11"
    ):
        read(texts=[message("G09", NOON, OF_WEEK)])
    with pytest.raises(
        LogError,
        match=r"day.nav: no orbit of C, E, G, R within hours of the receptions, 2023-06-29 12:00 "
        r"to 12:00; name the navigation file of that day",
    ):
        read(texts=[message("G07", NOON - timedelta(days=1), OF_WEEK - 86400.0)])


def test_across_the_change_of_weeks(read: Callable[..., RinexRanges]) -> None:
    """Receptions before and after midnight of Saturday, orbits of both weeks, told modulo 1024."""
    midnight = datetime(2023, 7, 2)
    receptions = [
        (midnight + timedelta(seconds=s), {"G07": (21e6, 0.0, 40.0), "C20": (23e6, 0.0, 40.0)})
        for s in (-1, 1, 5000)
    ]
    texts = [
        message("G07", midnight - timedelta(seconds=16), 604784.0, m0=0.7),
        message("C20", midnight, 0.0, m0=2.0, week=913.0),
    ]
    found = read(receptions, texts).table
    np.testing.assert_array_equal(found["t"], 604800.0 + np.repeat([-1.0, 1.0, 5000.0], 2))
    alike = read(receptions, [text.replace(number(2268.0), number(220.0)) for text in texts]).table
    np.testing.assert_array_equal(found["sat_x"], alike["sat_x"])
    position = found[["sat_x", "sat_y", "sat_z"]].to_numpy()
    velocity = found[["sat_vx", "sat_vy", "sat_vz"]].to_numpy()
    # both fly on through midnight
    np.testing.assert_allclose(position[2:4] - position[:2], 2.0 * velocity[:2], atol=5.0)


def test_beidou_and_glonass_keep_their_own_time(
    read: Callable[..., RinexRanges], tmp_path: Path
) -> None:
    read()
    told = read_navigation([tmp_path / "day.nav"], 2268, (OF_WEEK, OF_WEEK), "GREC")
    orbits = told.orbits.set_index("satellite")
    assert orbits.loc["G07", "toe"] == OF_WEEK
    assert orbits.loc["C20", "toe"] == OF_WEEK + 14.0
    assert orbits.loc["C20", "toe_of_week"] == OF_WEEK
    assert orbits.loc["C20", "toc"] == OF_WEEK + 14.0
    assert told.states.iloc[0]["toe"] == OF_WEEK - 900.0 + 18.0


@pytest.mark.parametrize(("system", "ahead"), [("GPS", 0), ("GAL", 0), ("BDT", 14), ("GLO", 18)])
def test_time_system_of_the_receiver(
    read: Callable[..., RinexRanges], system: str, ahead: float
) -> None:
    found = read(observations(usual(), system=system)).table
    np.testing.assert_array_equal(found["t"], OF_WEEK + ahead + np.repeat([0.0, 1.0], 4))


def test_an_unknown_time_system(read: Callable[..., RinexRanges]) -> None:
    with pytest.raises(LogError, match="time system 'XYZ' of the observation file is not known"):
        read(observations(usual(), system="XYZ"))


def test_the_clock_of_the_log(read: Callable[..., RinexRanges]) -> None:
    """Without a start it counts UTC since 1970, as the clocks of other files do."""
    found = read(clock_start=None)
    utc = (NOON - timedelta(seconds=18)).replace(tzinfo=UTC).timestamp()
    assert found.table["t"][0] == pytest.approx(utc, abs=1e-6)
    gps = found.table["t"] + found.gps_time_origin
    np.testing.assert_allclose(gps[:4], 2268 * 604800.0 + OF_WEEK, atol=1e-6)


def test_a_preferred_code(read: Callable[..., RinexRanges]) -> None:
    types = {"G": "C1C C1W D1C D1W S1C S1W"}
    receptions = [(NOON, {"G07": (21e6, 22e6, -10.0, -20.0, 40.0, 30.0)})]
    text = observations(receptions, types=types)
    assert read(text).table["pseudorange"][0] == 21e6
    other = read(text, codes={"G": ("C1W",)})
    assert other.table["pseudorange"][0] == 22e6
    assert other.table["cn0"][0] == 30.0
    assert other.table["range_rate"][0] == pytest.approx(20.0 * LIGHT / 1575.42e6)
    with pytest.raises(LogError, match=r"no pseudorange of a known code; its header names G C1C"):
        read(text, codes={"G": ("C1M",)})


def test_codes_of_other_carriers(read: Callable[..., RinexRanges]) -> None:
    types = {"G": "C2X D2X S2X", "C": "C7I D7I S7I"}
    text = observations([(NOON, {"G07": (21e6, -10.0, 40.0)})], types=types)
    with pytest.raises(ConfigError, match=r"codes.G: found C2X; .* L1 or E1 \(C1C"):
        read(text, codes={"G": ("C1C", "C2X")})
    with pytest.raises(ConfigError, match=r"codes.C: found C7I; ranges are read of B1I"):
        read(text, codes={"C": ("C7I",)})


def test_observations_that_are_scaled(read: Callable[..., RinexRanges]) -> None:
    plain, label = observations(usual()), "SYS / SCALE FACTOR"
    end = f"{'':60}END OF HEADER"
    same = plain.replace(end, f"{'G    1':60}{label}\n{end}")
    assert len(read(same).table) == len(read(plain).table)
    for lines in (["G  100"], ["G    1  1 L1C", "R   10  2 C1C D1C"]):
        told = "".join(f"{line:60}{label}\n" for line in lines)
        with pytest.raises(LogError, match=r"observations are scaled \(SYS / SCALE FACTOR"):
            read(plain.replace(end, told + end))


def test_what_was_not_received(read: Callable[..., RinexRanges]) -> None:
    receptions = [
        (
            NOON,
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


def test_duplicates(read: Callable[..., RinexRanges]) -> None:
    text = observations([usual(1)[0], usual(1)[0]])
    begin = text.index("> ")
    first = text[begin : text.index("> ", begin + 1)]
    twice = first.replace("  0  4", "  0  5") + f"G07{cells((99.0, 1.0, 1.0))}\n"
    found = read(text[:begin] + twice + first)
    assert len(found.table) == 4
    assert found.table["pseudorange"][0] == 21e6
    assert found.notes["receptions that came twice"] == 1
    assert found.notes["satellites that came twice in a reception"] == 1
    again = read(texts=[*messages(), *messages()])
    np.testing.assert_array_equal(again.table["sat_x"], read().table["sat_x"])


def test_events_are_skipped(read: Callable[..., RinexRanges]) -> None:
    text = observations(usual())
    at = text.index("> ", text.index("> ") + 1)
    comment = f"{'antenna moved':<60}COMMENT\n"
    event = announced(NOON, 3, 2) + comment * 2
    found = read(text[:at] + event + text[at:])
    assert len(found.table) == 8
    assert found.notes["events"] == 1
    # an event without a time, as some receivers write it
    blank = f">{'':30}4  1\n{comment}"
    assert len(read(text[:at] + blank + text[at:]).table) == 8
    changed = f">{'':30}4  1\n{'G    1 C5Q':<60}SYS / # / OBS TYPES\n"
    with pytest.raises(LogError, match="observation types change in the middle; split it"):
        read(text[:at] + changed + text[at:])


def test_cut_off_at_the_end(read: Callable[..., RinexRanges]) -> None:
    lines = observations(usual(3)).splitlines(keepends=True)
    found = read("".join(lines[:-2]))
    assert len(found.table) == 8
    assert found.notes["receptions cut off at the end"] == 1


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "no RINEX file"),
        ("\n\n\n", "no RINEX file"),
        ("hello, this is a letter\n" * 30, "no RINEX file"),
        (navigation([]), r"a RINEX file of type nav; expected an observation file"),
        (observations(usual()).replace("3.03", "4.00", 1), "RINEX version 4.0; versions"),
        (observations(usual())[:300], r"no pseudorange|cannot be read"),
        (observations([]), "no pseudorange of a known code"),
        (observations(usual()).replace("21000000.000", "21x00000.000"), r"found '21x00000.000'"),
        (observations(usual()).replace("21000000.000", "         inf"), r"found 'inf'"),
        (observations(usual()).replace("> 2023 06 29", "> 2023 06 31"), "no time in"),
        (observations(usual()).replace("\nG07", "\nGxx"), r"found 'Gxx' where a satellite"),
        (observations(usual()).replace("> 2023", "? 2023"), r"expected the line that begins"),
    ],
)  # fmt: skip
def test_damaged_observations(read: Callable[..., RinexRanges], text: str, message: str) -> None:
    with pytest.raises(LogError, match=message) as caught:
        read(text)
    assert str(caught.value).startswith("day.obs")


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "no RINEX file"),
        (observations(usual()), "a RINEX file of type obs; expected a navigation file"),
        (navigation(messages(), "4.00"), "RINEX version 4.0"),
        (navigation([]), "no orbit of"),
        (navigation(messages())[:100], "no orbit of|cannot be read"),
    ],
)
def test_damaged_navigation(read: Callable[..., RinexRanges], text: str, message: str) -> None:
    with pytest.raises(LogError, match=message) as caught:
        read(texts=text)
    assert str(caught.value).startswith("day.nav")


def test_a_message_cut_off_is_left_out(read: Callable[..., RinexRanges]) -> None:
    text = navigation([*messages(), message("G07", NOON + timedelta(hours=1), OF_WEEK + 3600.0)])
    whole = read().table
    for cut in (40, 200, 350):
        np.testing.assert_array_equal(read(texts=text[:-cut]).table["sat_x"], whole["sat_x"])


def test_compressed_and_hatanaka(tmp_path: Path) -> None:
    hatanaka = pytest.importorskip("hatanaka")
    plain = observations(usual())
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


def test_damage_is_told_as_such(read: Callable[..., RinexRanges]) -> None:
    """Bytes changed at random give ranges or an error that says where, never another."""
    draw = random.Random(4)
    whole = (observations(usual()), navigation(messages()))
    told = 0
    for k in range(60):
        texts = list(whole)
        damaged = list(texts[k % 2])
        for _ in range(draw.randint(1, 4)):
            damaged[draw.randrange(len(damaged))] = draw.choice("\n >GRx9.-eé")
        texts[k % 2] = "".join(damaged[: draw.randint(len(damaged) // 2, len(damaged))])
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            try:
                found = read(*texts)
            except LogError:
                told += 1
                continue
        assert np.isfinite(found.table[["pseudorange", "sat_x", "sat_clock"]]).all().all()
    assert told > 5


def version_2(receptions: Sequence[Reception], types: str) -> str:
    lines = [
        (f"{len(types.split()):6d}" + "".join(f"{t:>6}" for t in types.split()),
         "# / TYPES OF OBSERV"),
        (f"{'  2023     6    29    12     0    0.0000000':<48}GPS", "TIME OF FIRST OBS"),
        ("", "END OF HEADER"),
    ]  # fmt: skip
    text = header("2.11", "OBSERVATION DATA", lines)
    for time, satellites in receptions:
        names = list(satellites)
        seconds = time.second + time.microsecond * 1e-6
        first = f" {time:%y %m %d %H %M}{seconds:11.7f}  0{len(names):3d}{''.join(names[:12])}\n"
        text += first + "".join(
            f"{'':32}{''.join(names[k : k + 12])}\n" for k in range(12, len(names), 12)
        )
        for values in satellites.values():
            for k in range(0, len(values), 5):
                text += cells(values[k : k + 5]) + "\n"
    return text


def navigation_2(kind: str, texts: Sequence[str]) -> str:
    lines = [("", "END OF HEADER")]
    if kind == "NAVIGATION DATA":
        alpha = "  " + "".join(f"{v:12.4E}" for v in (1.5e-8, 2.2e-8, -1.2e-7, -1.2e-7))
        beta = "  " + "".join(f"{v:12.4E}" for v in (1e5, 2e5, -6e4, -4e5))
        lines = [(alpha.replace("E", "D"), "ION ALPHA"), (beta, "ION BETA"), *lines]
    body = ""
    for text in texts:
        first, *rest = text.splitlines()
        body += f"{int(first[1:3]):2d} {first[6:23]}.0"[:22].ljust(22) + first[23:] + "\n"
        body += "".join(line[1:] + "\n" for line in rest)
    begin = f"{'2.11':>9}{'':11}{kind:<20}{'':20}RINEX VERSION / TYPE\n"
    return begin + "".join(f"{text:<60}{label}\n" for text, label in lines) + body


def test_version_2_tells_the_same(read: Callable[..., RinexRanges], tmp_path: Path) -> None:
    sky = {"G07": SKY["G07"], "R03": SKY["R03"]}
    fillers = {f"S{k:02d}": (23e6, 0.0, 0.0, 0.0, 0.0, 30.0) for k in range(20, 33)}
    receptions = [
        (
            time,
            {
                **fillers,
                **{
                    name: (1e8, values[name][0], 7.0, values[name][1], 3.0, values[name][2])
                    for name in sky
                },
            },
        )
        for time, values in usual()
    ]
    (tmp_path / "old.23o").write_text(version_2(receptions, "L1 C1 L2 D1 P2 S1"))
    gps, _, _, glonass = messages()
    (tmp_path / "old.23n").write_text(navigation_2("NAVIGATION DATA", [gps]))
    (tmp_path / "old.23g").write_text(navigation_2("GLONASS NAV DATA", [glonass]))
    old = read_rinex(
        tmp_path / "old.23o", [tmp_path / "old.23n", tmp_path / "old.23g"], clock_start=CLOCK
    )
    new = read().table
    new = new[new["satellite"].isin(list(sky))].reset_index(drop=True)
    assert list(old.table["satellite"]) == list(new["satellite"])
    for column in new.columns.drop("satellite"):
        np.testing.assert_allclose(old.table[column], new[column], rtol=1e-12, atol=1e-9)
    assert old.klobuchar == (1.5e-8, 2.2e-8, -1.2e-7, -1.2e-7, 1e5, 2e5, -6e4, -4e5)


DESCRIPTOR = """
name: day
format: csv
path: .
tables:
  imu: {file: imu.csv}
  ranges:
    file: day.obs
    clock_start: 2023-06-24T23:59:42Z
"""


@pytest.fixture
def drive(read: Callable[..., RinexRanges], tmp_path: Path) -> Callable[[str], Path]:
    def made(more: str) -> Path:
        read()
        rows = "".join(f"{OF_WEEK + 0.1 * k},0.01\n" for k in range(21))
        (tmp_path / "imu.csv").write_text("t,gyro_z\n" + rows)
        (tmp_path / "day.yaml").write_text(DESCRIPTOR + more)
        return tmp_path / "day.yaml"

    return made


def test_a_drive_log_by_descriptor(drive: Callable[[str], Path]) -> None:
    log = read_log(drive("    navigation: day.nav\n    codes: {E: [C1X], G: [C1W, C1C]}\n"))
    assert log.ranges is not None
    np.testing.assert_array_equal(log.ranges["t"], np.repeat([0.0, 1.0], 4))
    assert log.metadata.gps_time_origin == 2268 * 604800.0 + OF_WEEK
    assert len(log.metadata.klobuchar) == 8
    assert log.metadata.range_corrections == ()
    assert log.metadata.extra["receiver"]["ranges"]["format"] == "rinex"
    assert log.metadata.extra["files"]["ranges"] == "day.obs"


def test_a_descriptor_without_navigation(drive: Callable[[str], Path]) -> None:
    with pytest.raises(ConfigError, match=r"tables.ranges: .* no orbits; state navigation"):
        read_log(drive(""))
    with pytest.raises(FileNotFoundError, match=r"other.nav: no such file"):
        read_log(drive("    navigation: other.nav\n"))
    with pytest.raises(ConfigError, match=r"codes\.X"):
        read_log(drive("    navigation: day.nav\n    codes: {X: [C1C]}\n"))


def test_a_clock_that_is_another(drive: Callable[[str], Path]) -> None:
    path = drive("    navigation: day.nav\n")
    path.write_text(path.read_text().replace("2023-06-24T23:59:42Z", "2023-06-25T00:00:42Z"))
    with pytest.raises(LogError, match=r"day.obs: ranges from .* no time in common; state clock"):
        read_log(path)


def test_rinex_gives_ranges_alone(drive: Callable[[str], Path]) -> None:
    with pytest.raises(ConfigError, match=r"tables.fixes: .* \(rinex\) gives ranges alone"):
        read_log(drive("    navigation: day.nav\n  fixes: {file: day.obs}\n"))
