"""The door of raw ranges: what passes, and what each refusal says."""

import numpy as np
import pandas as pd
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from navlearn.errors import LogError
from navlearn.logs.columns import REQUIRED
from navlearn.logs.drive_log import DriveLog, LogMetadata
from navlearn.logs.range_checks import checked_ranges
from navlearn.logs.range_tensors import ranges_of
from navlearn.logs.validate import validate_log


def test_a_sound_table_passes_as_it_is(range_table):
    pd.testing.assert_frame_equal(checked_ranges("ranges.csv", range_table()), range_table())
    assert checked_ranges("ranges.csv", range_table().iloc[:0]).empty


@pytest.mark.parametrize(
    ("row", "column", "value", "said"),
    [
        (4, "satellite", "G02", "comes twice"),
        (5, "satellite", "G02", "satellite G02 comes twice at 1 s, again in row 6"),
        (2, "satellite", "X07", r"satellite is 'X07' at row 3; expected the RINEX letter"),
        (2, "satellite", "7", "satellite is '7' at row 3"),
        (2, "satellite", "G7", "satellite is 'G7' at row 3; .*a number of two digits"),
        (2, "satellite", "G00", "satellite is 'G00' at row 3"),
        (2, "satellite", "S120", None),
        (2, "satellite", None, "satellite is nan at row 3"),
        (2, "satellite", "GPS 7", "satellite is 'GPS 7' at row 3"),
        (2, "pseudorange", np.nan, "pseudorange has no value at row 3 .satellite R07, 0"),
        (2, "sat_y", np.nan, "column sat_y has no value at row 3"),
        (2, "cn0", np.nan, None),
        (6, "t", 0.5, r"time steps back at row 7 \(0.5 s after 1 s; 1 such rows\); sort"),
        (6, "t", np.nan, "no time at row 7"),
        (4, "sat_x", 0.0, None),
        (4, ["sat_x", "sat_y", "sat_z"], 0.0, "G30 is 0 m .* orbit is not known"),
        (4, "sat_x", 1e200, "satellite G30 is inf m from"),
        (4, "sat_x", 9e7, "satellite G30 is 9.* m from the Earth's centre at row 5"),
        (4, "pseudorange", 3e5, None),
    ],
)
def test_single_rows(range_table, row, column, value, said):
    frame = range_table()
    frame.loc[row, column] = value
    frame = frame.astype({"satellite": "str"})
    if said is None:
        assert len(checked_ranges("ranges.csv", frame)) == 30
        return
    with pytest.raises(LogError, match=f"ranges.csv: .*{said}"):
        checked_ranges("ranges.csv", frame)


@pytest.mark.parametrize(
    ("columns", "factor", "said"),
    [
        (["sat_x", "sat_y", "sat_z"], 1e-3, "in km: give unit: km .or scale: 1000. in a desc"),
        (["pseudorange"], 1e-3, "pseudorange is 2100.* in the median.*in km: give unit: km"),
        (["pseudorange"], 1.0 / 299792458.0, "in s: give scale: 299792458"),
        (["pseudorange"], 1e3, "give its unit in a descriptor"),
    ],
)
def test_other_units(range_table, columns, factor, said):
    frame = range_table()
    frame[columns] *= factor
    with pytest.raises(LogError, match=said):
        checked_ranges("ranges.csv", frame)


def test_a_week_that_ends(range_table):
    frame = range_table([604798, 604799, 0, 1])
    with pytest.raises(LogError, match="a week ended there: add 604800 s to what follows"):
        checked_ranges("ranges.csv", frame)


@pytest.mark.parametrize(
    ("known", "said"),
    [
        ({"range_corrections": ("ionosfere",)}, r"'ionosfere' \(did you mean 'ionosphere'"),
        ({"klobuchar": (1.0, 2.0)}, "eight numbers, or none"),
        ({"klobuchar": (np.nan,) * 8}, "eight numbers, or none"),
        ({"gps_time_origin": -5.0}, "gps_time_origin is -5; expected GPS seconds"),
        ({"gps_time_origin": np.nan}, "gps_time_origin is nan"),
    ],
)
def test_what_cannot_be_known(make_log, known, said):
    with pytest.raises(LogError, match=said):
        validate_log(make_log(metadata=LogMetadata(name="small", **known)))


@st.composite
def any_ranges(draw, whole):
    rows = draw(st.integers(0, 6))
    number = st.floats(allow_nan=True, allow_infinity=True) | st.floats(1e7, 4e7)
    text = st.sampled_from(["G01", "R2", "E333", "X01", "07", ""]) | st.text(max_size=4)
    frame = whole[:rows].astype({"satellite": object})
    for column in draw(st.lists(st.sampled_from(list(frame)), max_size=3)):
        cell = text if column == "satellite" else number
        frame[column] = draw(st.lists(cell | st.none(), min_size=rows, max_size=rows))
    return frame.drop(columns=draw(st.lists(st.sampled_from(list(frame)), max_size=1)))


@settings(
    max_examples=150, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture]
)
@given(data=st.data())
def test_any_table_of_ranges(data, tables, range_table, broadcast):
    frame = data.draw(any_ranges(range_table()))
    log = DriveLog(**tables, ranges=frame, metadata=broadcast)
    try:
        sound = validate_log(log)
    except LogError as error:
        if "small: ranges: " not in str(error):
            pytest.fail(str(error))
        return
    found = sound.ranges
    assert (np.diff(found["t"]) >= 0.0).all()
    assert not found.duplicated(["t", "satellite"]).any()
    assert np.isfinite(found[["t", *REQUIRED["ranges"][1:]]].to_numpy()).all()
    series = ranges_of(sound, np.arange(11.0))
    assert all(part.isfinite().all() for part in series.ranges)
