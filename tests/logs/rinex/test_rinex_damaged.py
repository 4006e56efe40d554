"""RINEX files that are damaged, or no RINEX at all."""

import random
import warnings
from collections.abc import Callable
from datetime import timedelta
from typing import Any

import numpy as np
import pytest

from navlearn.errors import LogError
from navlearn.logs.formats.rinex import RinexRanges

Text = Callable[[Any], str]


def swapped(old: str, new: str, count: int = -1) -> Text:
    """Return what writes observations in which something stands in the place of something."""
    return lambda files: files.observations(files.usual()).replace(old, new, count)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (lambda _: "", "no RINEX file"),
        (lambda _: "\n\n\n", "no RINEX file"),
        (lambda _: "hello, this is a letter\n" * 30, "no RINEX file"),
        (lambda files: files.navigation([]),
         "a RINEX file of type nav; expected an observation file"),
        (swapped("3.03", "4.00", 1), "RINEX version 4.0; versions"),
        (lambda files: files.observations(files.usual())[:300], r"no pseudorange|cannot be read"),
        (lambda files: files.observations([]), "no pseudorange of a known code"),
        (swapped("21000000.000", "21x00000.000"), r"found '21x00000.000'"),
        (swapped("21000000.000", "         inf"), r"found 'inf'"),
        (swapped("> 2023 06 29", "> 2023 06 31"), "no time in"),
        (swapped("\nG07", "\nGxx"), r"found 'Gxx' where a satellite"),
        (swapped("> 2023", "? 2023"), r"expected the line that begins"),
    ],
)  # fmt: skip
def test_damaged_observations(
    files: Any, read: Callable[..., RinexRanges], text: Text, message: str
) -> None:
    with pytest.raises(LogError, match=message) as caught:
        read(text(files))
    assert str(caught.value).startswith("day.obs")


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (lambda _: "", "no RINEX file"),
        (
            lambda files: files.observations(files.usual()),
            "a RINEX file of type obs; expected a navigation file",
        ),
        (lambda files: files.navigation(files.messages(), "4.00"), "RINEX version 4.0"),
        (lambda files: files.navigation([]), "no orbit of"),
        (lambda files: files.navigation(files.messages())[:100], "no orbit of|cannot be read"),
    ],
)
def test_damaged_navigation(
    files: Any, read: Callable[..., RinexRanges], text: Text, message: str
) -> None:
    with pytest.raises(LogError, match=message) as caught:
        read(texts=text(files))
    assert str(caught.value).startswith("day.nav")


def test_a_message_cut_off_is_left_out(files: Any, read: Callable[..., RinexRanges]) -> None:
    text = files.navigation(
        [
            *files.messages(),
            files.message("G07", files.NOON + timedelta(hours=1), files.OF_WEEK + 3600.0),
        ]
    )
    whole = read().table
    for cut in (40, 200, 350):
        np.testing.assert_array_equal(read(texts=text[:-cut]).table["sat_x"], whole["sat_x"])


def test_damage_is_told_as_such(files: Any, read: Callable[..., RinexRanges]) -> None:
    """Bytes changed at random give ranges or an error that says where, never another."""
    draw = random.Random(4)
    whole = (files.observations(files.usual()), files.navigation(files.messages()))
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
