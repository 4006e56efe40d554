"""RINEX files made for each quirk of observations and navigation, version 3 but where told."""

from collections.abc import Callable, Sequence
from datetime import UTC, datetime, timedelta
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from navlearn.logs.formats.rinex import RinexRanges, read_rinex

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


@pytest.fixture(autouse=True, scope="session")
def georinex() -> None:
    """Skip what reads RINEX where its reader is not installed."""
    pytest.importorskip("georinex")


@pytest.fixture(scope="session")
def files() -> SimpleNamespace:
    """What writes the files, whole or line by line."""
    return SimpleNamespace(
        NOON=NOON,
        OF_WEEK=OF_WEEK,
        CLOCK=CLOCK,
        SKY=SKY,
        header=header,
        cells=cells,
        announced=announced,
        usual=usual,
        observations=observations,
        number=number,
        message=message,
        state_message=state_message,
        messages=messages,
        navigation=navigation,
    )


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
