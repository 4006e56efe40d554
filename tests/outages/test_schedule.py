import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from navlearn.errors import ConfigError
from navlearn.outages.schedule import Outage, OutageProtocol, parse_outages, refuse_overlaps


@pytest.mark.parametrize(
    ("text", "expected"),
    [("10x60", (10, 60.0)), ("7 X 120", (7, 120.0)), ("3×2.5s", (3, 2.5)), (" 1x1 ", (1, 1.0))],
)
def test_count_and_duration_are_read(text: str, expected: tuple[int, float]) -> None:
    assert parse_outages(text) == expected


@pytest.mark.parametrize("text", ["", "10", "x60", "10x", "0x60", "10x0", "-1x60", "10x60x2", "a"])
def test_other_texts_are_refused_with_an_example(text: str) -> None:
    with pytest.raises(ConfigError, match="such as 10x60"):
        parse_outages(text)


@given(st.text(max_size=12))
def test_any_text_is_read_or_refused(text: str) -> None:
    try:
        count, duration = parse_outages(text)
    except ConfigError:
        return
    assert count >= 1
    assert duration > 0.0


@pytest.mark.parametrize(("start", "duration"), [(0.0, 0.0), (0.0, -1.0), (0.0, math.nan)])
def test_outage_needs_a_length(start: float, duration: float) -> None:
    with pytest.raises(ConfigError, match="positive number of seconds"):
        Outage(start, duration)


def test_outage_needs_a_start() -> None:
    with pytest.raises(ConfigError, match="start is nan"):
        Outage(math.nan, 1.0)


def test_touching_outages_are_no_overlap_but_shared_time_is() -> None:
    refuse_overlaps((Outage(10.0, 5.0), Outage(15.0, 5.0)))
    with pytest.raises(
        ConfigError, match=r"from 10 to 15 s overlaps the one that starts at 14[.]9"
    ):
        refuse_overlaps((Outage(10.0, 5.0), Outage(14.9, 5.0)))


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"placement": "even"}, "expected one of spread, listed"),
        ({"placement": "listed"}, "with 0 times"),
        ({"times": (3.0,)}, "and only there"),
        ({"count": 0}, "at least 1"),
        ({"duration": 0.0}, "duration is 0.0"),
        ({"duration": math.inf}, "duration is inf"),
        ({"warm_up": -1.0}, "warm_up is -1.0"),
        ({"min_gap": math.nan}, "min_gap is nan"),
        ({"classes": ("curve",)}, "classes are"),
        ({"classes": ("turn", "turn")}, "each once"),
    ],
)
def test_wrong_options_are_named(options: dict[str, object], message: str) -> None:
    with pytest.raises(ConfigError, match=message):
        OutageProtocol(**options)  # type: ignore[arg-type]
