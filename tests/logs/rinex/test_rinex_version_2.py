"""RINEX 2 tells the same as RINEX 3."""

from collections.abc import Callable, Sequence
from datetime import datetime
from pathlib import Path
from typing import Any

import numpy as np

from navlearn.logs.formats.rinex import RinexRanges, read_rinex

Values = Sequence[float | str | None]
Reception = tuple[datetime, dict[str, Values]]


def version_2(files: Any, receptions: Sequence[Reception], types: str) -> str:
    lines = [
        (f"{len(types.split()):6d}" + "".join(f"{t:>6}" for t in types.split()),
         "# / TYPES OF OBSERV"),
        (f"{'  2023     6    29    12     0    0.0000000':<48}GPS", "TIME OF FIRST OBS"),
        ("", "END OF HEADER"),
    ]  # fmt: skip
    text = files.header("2.11", "OBSERVATION DATA", lines)
    for time, satellites in receptions:
        names = list(satellites)
        seconds = time.second + time.microsecond * 1e-6
        first = f" {time:%y %m %d %H %M}{seconds:11.7f}  0{len(names):3d}{''.join(names[:12])}\n"
        text += first + "".join(
            f"{'':32}{''.join(names[k : k + 12])}\n" for k in range(12, len(names), 12)
        )
        for values in satellites.values():
            for k in range(0, len(values), 5):
                text += files.cells(values[k : k + 5]) + "\n"
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


def test_version_2_tells_the_same(
    files: Any, read: Callable[..., RinexRanges], tmp_path: Path
) -> None:
    sky = {"G07": files.SKY["G07"], "R03": files.SKY["R03"]}
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
        for time, values in files.usual()
    ]
    (tmp_path / "old.23o").write_text(version_2(files, receptions, "L1 C1 L2 D1 P2 S1"))
    gps, _, _, glonass = files.messages()
    (tmp_path / "old.23n").write_text(navigation_2("NAVIGATION DATA", [gps]))
    (tmp_path / "old.23g").write_text(navigation_2("GLONASS NAV DATA", [glonass]))
    old = read_rinex(
        tmp_path / "old.23o", [tmp_path / "old.23n", tmp_path / "old.23g"], clock_start=files.CLOCK
    )
    new = read().table
    new = new[new["satellite"].isin(list(sky))].reset_index(drop=True)
    assert list(old.table["satellite"]) == list(new["satellite"])
    for column in new.columns.drop("satellite"):
        np.testing.assert_allclose(old.table[column], new[column], rtol=1e-12, atol=1e-9)
    assert old.klobuchar == (1.5e-8, 2.2e-8, -1.2e-7, -1.2e-7, 1e5, 2e5, -6e4, -4e5)
