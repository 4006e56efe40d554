import math
import re
from pathlib import Path

import pytest

from navlearn.errors import ConfigError, LogNotFoundError, OutputExistsError
from navlearn.recipe.filter_options import ekf_options
from navlearn.recipe.tuned_spec import TunedOn, TunedSpec, read_tuned, write_tuned


def a_spec() -> TunedSpec:
    return TunedSpec(
        name="kingston",
        method="differences",
        filter={"noise": {"gyro_random_walk": 2e-4}, "initial": {"gyro": {"bias": 1e-3}}},
        made_from=(TunedOn(log="drive 11", fingerprint="abc", from_s=0.0, until_s=600.0),),
        figures={"nis": {"position": 1.9}, "seconds": 12},
        notes=("the reference drifts",),
    )


def test_what_is_written_is_read_again(tmp_path: Path) -> None:
    path = tmp_path / "deep" / "tuned.yaml"
    write_tuned(path, a_spec())
    assert read_tuned(path) == a_spec()
    assert [found.name for found in path.parent.iterdir()] == ["tuned.yaml"]


def test_infinite_correlation_time_survives_the_file(tmp_path: Path) -> None:
    write_tuned(tmp_path / "a.yaml", TunedSpec(filter={"correlation_time": math.inf}))
    assert read_tuned(tmp_path / "a.yaml").filter == {"correlation_time": math.inf}


def test_nothing_is_overwritten_unless_told(tmp_path: Path) -> None:
    path = tmp_path / "tuned.yaml"
    path.write_text("mine\n", encoding="utf-8")
    with pytest.raises(OutputExistsError, match="exists"):
        write_tuned(path, a_spec())
    assert path.read_text(encoding="utf-8") == "mine\n"
    write_tuned(path, a_spec(), replace=True)
    assert read_tuned(path) == a_spec()


def test_a_folder_is_never_replaced(tmp_path: Path) -> None:
    with pytest.raises(OutputExistsError, match="is a folder"):
        write_tuned(tmp_path, a_spec(), replace=True)


def test_tuned_values_are_laid_over_those_of_a_recipe() -> None:
    recipe = {
        "standstill": 2.0,
        "noise": {"gyro_random_walk": 1.0, "speed_noise": 0.3},
        "initial": {"gyro": {"scale": 0.5, "bias": 0.5}, "position": 9.0},
    }
    laid = a_spec().laid_over(recipe)
    assert laid == {
        "standstill": 2.0,
        "noise": {"gyro_random_walk": 2e-4, "speed_noise": 0.3},
        "initial": {"gyro": {"scale": 0.5, "bias": 1e-3}, "position": 9.0},
    }
    assert recipe["noise"] == {"gyro_random_walk": 1.0, "speed_noise": 0.3}
    assert ekf_options(laid).noise.gyro_random_walk == 2e-4


def test_sensors_tell_whose_options_they_are() -> None:
    spec = TunedSpec(sensors="imu", filter={"noise": {"accel_random_walk": 0.02}})
    assert spec.laid_over({"states": 21}) == {"states": 21, "noise": {"accel_random_walk": 0.02}}
    with pytest.raises(ValueError, match="accel_random_walk"):
        TunedSpec(sensors="riss", filter={"noise": {"accel_random_walk": 0.02}})


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("filter: {noise: {gyro_random_wlk: 1.0}}", "gyro_random_walk"),
        ("filter: {noise: {gyro_random_walk: -1.0}}", "expected a finite value >= 0"),
        ("filter: {noise: {gyro_random_walk: much}}", "tuned.yaml:1.*number"),
        ("filter: {}", "at least 1"),
        ("name: x", "'filter' is missing"),
        ("filter: {standstill: 1.0}\nmethod: guess", "tuned.yaml:2: method is 'guess'"),
        ("filter: {standstill: 1.0}\ncolour: red", "tuned.yaml:2: unknown key 'colour'"),
        ("filter: {standstill: 1.0}\nfigures: {nis: low}", "figures"),
        (
            "filter: {standstill: 1.0}\nmade_from: [{log: a, from_s: 9, until_s: 3}]",
            "until_s 3 is not later than from_s 9",
        ),
    ],
)
def test_what_is_wrong_is_told_with_its_place(tmp_path: Path, text: str, said: str) -> None:
    path = tmp_path / "tuned.yaml"
    path.write_text(text, encoding="utf-8")
    with pytest.raises(ConfigError) as found:
        read_tuned(path)
    assert re.search(said, str(found.value)), str(found.value)


def test_a_missing_file_is_said_to_be_missing(tmp_path: Path) -> None:
    with pytest.raises(LogNotFoundError, match="no such tuned spec file"):
        read_tuned(tmp_path / "tuned.yaml")
