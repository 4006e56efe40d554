from pathlib import Path

import numpy as np
import pytest
import yaml
from hypothesis import given, settings
from hypothesis import strategies as st

from navlearn.errors import ConfigError, LogNotFoundError, NavlearnError
from navlearn.logs.descriptor import Descriptor, load_descriptor

GOOD = {"name": "x", "format": "csv", "path": "folder"}
DATASETS = Path(__file__).resolve().parents[2] / "datasets"


def written(tmp_path, **entries):
    path = tmp_path / "log.yaml"
    path.write_text(yaml.safe_dump({**GOOD, **entries}), encoding="utf-8")
    return path


def refusal(tmp_path, **entries):
    with pytest.raises(ConfigError) as error:
        load_descriptor(written(tmp_path, **entries))
    return str(error.value)


def test_path_is_relative_to_the_descriptor(tmp_path):
    descriptor, path = load_descriptor(written(tmp_path))
    assert path == tmp_path / "folder"
    assert descriptor.on_backstep == "error"


def test_data_folder_from_the_environment_or_beside_the_repository(tmp_path, monkeypatch):
    path = written(tmp_path, path="${NAVLEARN_DATA}/kingston")
    monkeypatch.setenv("NAVLEARN_DATA", "/some/where")
    assert load_descriptor(path)[1] == Path("/some/where/kingston")
    (tmp_path / "elsewhere" / "deep").mkdir(parents=True)
    monkeypatch.chdir(tmp_path / "elsewhere" / "deep")
    monkeypatch.setenv("NAVLEARN_DATA", "../data")
    assert load_descriptor(path)[1] == tmp_path / "elsewhere" / "data" / "kingston"
    monkeypatch.delenv("NAVLEARN_DATA")
    assert load_descriptor(path)[1] == (tmp_path / "../../shared/data/kingston").resolve()


@pytest.mark.parametrize(
    ("entries", "message"),
    [
        ({"on_backsteps": "drop"}, "unknown key on_backsteps (did you mean 'on_backstep'?)"),
        (
            {"format": "cvs"},
            "format: Input should be 'navinst', 'canedge', 'kitti', 'comma2k19', 'sensorlogger'",
        ),
        ({"origin": {"lat": 49.0}}, "unknown key origin.lat (did you mean 'lat_deg'?)"),
        ({"section_s": [9.0, 3.0]}, "section_s: ends at 3 s, before it starts"),
        ({"section_s": [-1.0, 3.0]}, "section_s.0: Input should be greater than or equal to 0"),
        ({"reference_latency": {"poses": 1.0}}, "unknown key reference_latency.poses (did you"),
        ({"lever_arm": [1.0, 2.0]}, "lever_arm"),
        ({"gnss_latency": 100.0}, "gnss_latency: Input should be less than or equal to 10"),
        ({"mounting": {"rol_deg": 5.7}}, "unknown key mounting.rol_deg (did you mean 'roll_deg'?)"),
        ({"tables": {"imu": {"file": "a", "colums": {}}}}, "did you mean 'columns'?"),
        ({"tables": {"gps": {"file": "a.csv"}}}, "tables.gps"),
        ({"axes": "FFU"}, "log.yaml: axes: FFU is no right-handed triad"),
        (
            {"axes": {"rigth": "x", "forward": "y", "up": "z"}},
            "unknown key axes.rigth (did you mean 'right'?)",
        ),
        ({"name": ""}, "name: String should have at least 1 character"),
        ({"geoid_height": float("nan")}, "geoid_height: Input should be a finite number"),
    ],
)
def test_wrong_entries(tmp_path, entries, message):
    assert message in refusal(tmp_path, **entries)


def test_a_missing_key_is_named(tmp_path):
    path = tmp_path / "log.yaml"
    path.write_text("name: x\nformat: csv\n", encoding="utf-8")
    with pytest.raises(ConfigError, match=r"log.yaml: path: Field required"):
        load_descriptor(path)


def test_a_wrong_column_entry_is_named(tmp_path):
    table = {"file": "a", "columns": {"speed": {"colum": "v"}}}
    message = refusal(tmp_path, tables={"odometer": table})
    assert "unknown key tables.odometer.columns.speed.colum (did you mean 'column'?)" in message


@pytest.mark.parametrize("text", ["a: [", "- 1\n- 2\n", "", "just text", "\tx: 1"])
def test_not_a_mapping(tmp_path, text):
    path = tmp_path / "log.yaml"
    path.write_text(text, encoding="utf-8")
    with pytest.raises(ConfigError, match=r"log\.yaml: "):
        load_descriptor(path)


def test_binary_file(tmp_path):
    path = tmp_path / "log.yaml"
    path.write_bytes(b"\xff\xfe\x00\x81")
    with pytest.raises(ConfigError, match="not readable as YAML"):
        load_descriptor(path)


def test_no_file(tmp_path):
    with pytest.raises(LogNotFoundError, match="no such descriptor"):
        load_descriptor(tmp_path / "nothing.yaml")


def test_axes_of_the_format_unless_stated():
    plain = Descriptor.model_validate(GOOD)
    np.testing.assert_array_equal(plain.body_from_sensor("RFU"), np.eye(3))
    stated = Descriptor.model_validate({**GOOD, "axes": "FLU", "mounting": {"roll_deg": 10.0}})
    left = stated.body_from_sensor("RFU") @ np.array([0.0, 1.0, 0.0])
    # The sensor's y points left; rolled right side down by 10° in the car, left points up a bit.
    np.testing.assert_allclose(left, [-np.cos(np.radians(10)), 0.0, np.sin(np.radians(10))])


@pytest.mark.parametrize("path", sorted(DATASETS.glob("*.yaml")), ids=lambda path: path.stem)
def test_every_shipped_descriptor_parses(path):
    descriptor, _ = load_descriptor(path)
    assert descriptor.body_from_sensor("RFU").shape == (3, 3)
    assert descriptor.license


entries = st.recursive(
    st.none() | st.booleans() | st.floats() | st.text(max_size=8) | st.integers(),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.text(max_size=8), inner),
    max_leaves=6,
)


@settings(max_examples=80, deadline=None)
@given(st.dictionaries(st.sampled_from(sorted(Descriptor.model_fields)), entries, max_size=6))
def test_any_entries_give_a_descriptor_or_a_refusal(tmp_path_factory, found):
    path = tmp_path_factory.mktemp("fuzz") / "log.yaml"
    path.write_text(yaml.safe_dump({**GOOD, **found}), encoding="utf-8")
    try:
        load_descriptor(path)
    except NavlearnError as error:
        refusal = str(error)
        if "log.yaml" not in refusal:
            pytest.fail(refusal)
