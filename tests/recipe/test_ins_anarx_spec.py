"""Spec of ANARX on the position error of a full-IMU navigator."""

from pathlib import Path

import pytest

from navlearn.errors import ConfigError
from navlearn.learning.ins_regressors import INS_CHANNELS
from navlearn.learning.position_series import SERIES_INPUTS
from navlearn.recipe import load_spec
from navlearn.recipe.ins_anarx_spec import PAPER_INPUTS, InsAnarxSpec
from navlearn.recipe.spec import BUILT_IN

ROOT = Path(__file__).resolve().parents[2]

CORNERS = {
    "jaradat2017": ("paper", "open_loop"),
    "jaradat2017_closed": ("paper", "closed_loop"),
    "ins_ekf+anarx": ("sound", "closed_loop"),
    "ins_ekf+anarx_open": ("sound", "open_loop"),
}


@pytest.mark.parametrize("name", CORNERS)
def test_built_in_models_are_the_four_corners(name):
    spec = BUILT_IN[name]
    assert isinstance(spec, InsAnarxSpec)
    assert (spec.mode, spec.training) == CORNERS[name]
    paper = spec.mode == "paper"
    assert spec.split == ("random" if paper else "time")
    # The paper has no safeguard; everything else has one.
    assert spec.safeguard.gate is spec.safeguard.bounds is not paper
    assert spec.training_options().loop == spec.training.removesuffix("_loop")
    assert spec.anarx_options(outputs=1).inputs == len(spec.inputs)
    assert spec.training.replace("_", " ") in spec.describe()
    assert spec.seeds == {name: 0}


def test_paper_mode_has_the_papers_network():
    spec = InsAnarxSpec(name="a", mode="paper")
    assert spec.inputs == PAPER_INPUTS == tuple(SERIES_INPUTS)
    network = spec.anarx_options(outputs=1)
    assert (network.activation, network.linear_path) == ("sigmoid", False)
    assert spec.training == "open_loop"
    assert BUILT_IN["jaradat2017_safe"].safeguard.gate
    assert InsAnarxSpec(name="a", mode="paper", hidden=4, split="time").hidden == 4


def test_increments_count_by_their_sum_in_closed_loop_only():
    objective = {
        (mode, loop): InsAnarxSpec(name="a", mode=mode, training=loop).training_options().objective
        for mode in ("paper", "sound")
        for loop in ("open_loop", "closed_loop")
    }
    assert objective.pop(("sound", "closed_loop")) == "accumulated"
    assert set(objective.values()) == {"step"}


@pytest.mark.parametrize(
    ("content", "said"),
    [
        ({"split": "random"}, "exists in mode 'paper' alone"),
        ({"window_s": 100.0}, "belong to mode 'paper'"),
        ({"targets": "at_fixes"}, "belong to mode 'paper'"),
        ({"inputs": ["ins_position"]}, "unknown input 'ins_position' of mode sound"),
        ({"mode": "paper", "inputs": ["yaw_rate"]}, "unknown input 'yaw_rate' of mode paper"),
        ({"inputs": ["delay", "delay"]}, "listed twice"),
        ({"inputs": ["yaw_rat"]}, "did you mean 'yaw_rate'"),
        ({"training": "loop"}, "expected 'open_loop' or 'closed_loop'"),
        ({"hiden": 3}, "unknown key 'hiden'"),
        ({"mode": "papers"}, "expected 'paper' or 'sound'"),
    ],
)
def test_what_does_not_fit_is_refused(tmp_path, content, said):
    lines = [f"{key}: {value}" for key, value in content.items()]
    path = tmp_path / "spec.yaml"
    path.write_text("name: a\ntype: ins_anarx\n" + "\n".join(lines), encoding="utf-8")
    with pytest.raises(ConfigError, match=said):
        load_spec(path)


def test_every_channel_may_be_an_input():
    assert InsAnarxSpec(name="a", inputs=tuple(INS_CHANNELS)).inputs == tuple(INS_CHANNELS)


@pytest.mark.parametrize("name", ["jaradat2017", "ins_ekf+anarx"])
def test_shipped_specs_are_the_built_in_ones_and_write_out_every_key(name):
    path = ROOT / "models" / f"{name}.yaml"
    assert load_spec(path).model_copy(update={"question": ""}) == BUILT_IN[name]
    text = path.read_text(encoding="utf-8")
    for key in set(InsAnarxSpec.model_fields) - {"notes"}:
        assert f"\n{key}:" in text, key
    assert path.with_suffix(".md").is_file()
