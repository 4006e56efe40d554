"""Sweeps as they are written down: typed, strict, and the same when read again."""

from pathlib import Path

import pytest
import yaml

from navlearn.errors import ConfigError, LogNotFoundError
from navlearn.recipe import load_recipe
from navlearn.recipe.sweep import is_sweep, load_sweep
from navlearn.recipe.swept_drives import DegradedDrives, SimulatedDrives

SWEEP = """
name: few
question: Does it help?
sweep:
  {type: simulated, grades: [mems_l, tactical], drives: 3, first_seed: 7, durations_s: [20, 30]}
methods: [ekf, anarx, oracle]
outages: {count: 2, warm_up_s: 100}
filter: {noise: {turn_noise: 0.01}}
"""


def written(folder: Path, text: str) -> Path:
    path = folder / "few.yaml"
    path.write_text(text, encoding="utf-8")
    return path


def test_a_sweep_tells_its_drives(tmp_path: Path) -> None:
    path = written(tmp_path, SWEEP)
    assert is_sweep(path)
    sweep = load_sweep(path)
    assert isinstance(sweep.sweep, SimulatedDrives)
    assert sweep.sweep.seeds == (7, 8, 9)
    assert [spec.name for spec in sweep.models] == ["anarx"]
    one = sweep.for_drive("some_drive", 30.0)
    assert one.outages.duration_s == 30.0
    assert one.outages.count == 2
    assert one.methods == sweep.methods
    assert one.ekf_options().noise.turn_noise == 0.01
    assert one.model("anarx") == sweep.models[0]


def test_a_grade_may_have_its_own_filter(tmp_path: Path) -> None:
    grade = load_sweep(written(tmp_path, SWEEP)).sweep.grades[0]
    text = SWEEP + f"filter_by_grade: {{{grade}: {{noise: {{speed_noise: 0.2}}}}}}\n"
    sweep = load_sweep(written(tmp_path, text))
    own = sweep.for_drive("some_drive", 30.0, grade).ekf_options().noise
    assert (own.speed_noise, own.turn_noise) == (0.2, 0.01)
    assert sweep.for_drive("some_drive", 30.0).ekf_options().noise.speed_noise != 0.2
    with pytest.raises(ConfigError, match="not among the grades"):
        load_sweep(written(tmp_path, SWEEP + "filter_by_grade: {low_cost_obd: {}}\n"))
    with pytest.raises(ConfigError, match="unknown grade"):
        load_sweep(written(tmp_path, SWEEP + "filter_by_grade: {memsl: {}}\n"))


def test_resolved_and_read_again_it_is_the_same(tmp_path: Path) -> None:
    sweep = load_sweep(written(tmp_path, SWEEP))
    again = tmp_path / "resolved.yaml"
    again.write_text(yaml.safe_dump(sweep.resolved()), encoding="utf-8")
    assert load_sweep(again) == sweep


def test_a_quick_look_changes_nothing_else(tmp_path: Path) -> None:
    sweep = load_sweep(written(tmp_path, SWEEP))
    short = sweep.shortened(drives=1, outages=5)
    assert short.sweep.seeds == (7,)
    assert short.outages.count == 5
    assert short.shortened(drives=3, outages=2) == sweep
    assert sweep.shortened() == sweep
    with pytest.raises(ConfigError, match="drives"):
        sweep.shortened(drives=0)


def test_a_real_drive_is_found_from_where_the_sweep_lies(tmp_path: Path) -> None:
    text = SWEEP.replace("type: simulated,", "type: degraded, log: {path: ../drive},")
    sweep = load_sweep(written(tmp_path, text))
    assert isinstance(sweep.sweep, DegradedDrives)
    assert sweep.sweep.log.path == tmp_path.parent / "drive"


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ("mems_l", "mems_ll", "unknown grade 'mems_ll' (did you mean 'mems_l'"),
        ("[mems_l, tactical]", "[mems_l, mems_l]", "list each once"),
        ("[mems_l, tactical]", "[]", "grades"),
        ("type: simulated", "type: invented", "sweep.type is 'invented'; expected one of"),
        ("type: simulated, ", "", "type"),
        ("drives: 3", "dirves: 3", "few.yaml:5: unknown key 'dirves' in sweep (did you mean"),
        ("drives: 3", "profile: towm", "unknown profile 'towm' (did you mean 'town'"),
        ("durations_s: [20, 30]", "durations_s: [-20]", "durations_s"),
        ("count: 2", "duration_s: 60", "sweep.durations_s in its place"),
        ("methods: [ekf", "methods: [efk", "unknown method 'efk' (did you mean 'ekf'"),
        ("methods:", "observability: true\nmethods:", "in a recipe of one of its drives"),
        ("warm_up_s", "warmup_s", "few.yaml:7: unknown key 'warmup_s' in outages"),
    ],
)
def test_what_is_wrong_is_told_with_its_line(old: str, new: str, said: str, tmp_path: Path) -> None:
    assert old in SWEEP
    with pytest.raises(ConfigError) as caught:
        load_sweep(written(tmp_path, SWEEP.replace(old, new)))
    assert said in str(caught.value)


def test_recipe_and_sweep_are_not_taken_for_each_other(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="this is a sweep over many drives"):
        load_recipe(written(tmp_path, SWEEP))
    plain = written(tmp_path, "name: one\nlog: {path: drive}\n")
    assert not is_sweep(plain)
    with pytest.raises(ConfigError, match="'sweep' is missing"):
        load_sweep(plain)
    with pytest.raises(LogNotFoundError, match="no such recipe"):
        is_sweep(tmp_path / "none.yaml")


def test_a_real_drive_is_not_spoilt_twice(tmp_path: Path) -> None:
    log = "log: {path: ../drive, gyro: {grade: mems_l}}"
    text = SWEEP.replace("type: simulated,", f"type: degraded, {log},")
    with pytest.raises(ConfigError, match="the sweep's grades tell the gyro's error"):
        load_sweep(written(tmp_path, text))


SATELLITES = SWEEP.replace("[20, 30]", "[20, 30], satellites: [2, 0], sky: suburban")


def test_numbers_of_satellites_are_a_dimension_of_their_own(tmp_path: Path) -> None:
    sweep = load_sweep(written(tmp_path, SATELLITES))
    assert sweep.conditions == ((20.0, 2), (20.0, 0), (30.0, 2), (30.0, 0))
    assert isinstance(sweep.sweep, SimulatedDrives)
    assert sweep.sweep.sky == "suburban"
    two, none = (sweep.for_drive("any", 30.0, satellites=number) for number in (2, 0))
    assert (two.outages.satellites, none.outages.satellites) == (2, 0)
    # The same outages: those through which two could stay.
    assert two.outages.min_satellites == none.outages.min_satellites == 2
    assert none.outages.protocol().min_satellites == 2
    again = tmp_path / "resolved.yaml"
    again.write_text(yaml.safe_dump(sweep.resolved()), encoding="utf-8")
    assert load_sweep(again) == sweep
    assert sweep.shortened(drives=1).sweep.satellites == (2, 0)
    assert load_sweep(written(tmp_path, SWEEP)).conditions == ((20.0, 0), (30.0, 0))


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (
            SWEEP.replace("count: 2,", "count: 2, satellites: 1,"),
            r"outages\.satellites: a sweep has sweep\.satellites in its place",
        ),
        (SATELLITES.replace("[2, 0]", "[2, 2]"), "list each once"),
        (SATELLITES.replace("[2, 0]", "[-1]"), "greater than or equal to 0"),
        (SATELLITES.replace("suburban", "subruban"), "did you mean 'suburban'"),
        (
            SATELLITES.replace(
                "count: 2,", "count: 2, visible: listed, visible_satellites: [G01],"
            ),
            r"sweep\.satellites: 2 are to stay but outages\.visible_satellites lists 1",
        ),
    ],
)
def test_numbers_that_do_not_fit_are_refused(tmp_path: Path, text: str, message: str) -> None:
    with pytest.raises(ConfigError, match=message):
        load_sweep(written(tmp_path, text))


def test_listed_satellites_are_taken_from_the_front(tmp_path: Path) -> None:
    text = SATELLITES.replace(
        "count: 2,", "count: 2, visible: listed, visible_satellites: [G05, G01],"
    )
    protocol = load_sweep(written(tmp_path, text)).for_drive("any", 20.0, satellites=1).outages
    assert protocol.protocol().visible_satellites == ("G05", "G01")
    assert protocol.protocol().satellites == 1
