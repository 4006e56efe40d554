"""Gyro terms chosen over drives, and the spec that comes of it."""

import pytest

from navlearn.errors import ConfigError
from navlearn.experiment.gyro_term_choice import (
    CANDIDATES,
    choose_gyro_terms,
    save_augmented_spec,
)
from navlearn.logs.synthetic import simulate_drive
from navlearn.recipe import load_spec
from navlearn.recipe.augmented_spec import AugmentedSpec


@pytest.fixture(scope="module")
def logs():
    """Two cars with gyros whose scale is off by −4 % and by −0.6 %, and 2 % uneven."""
    return [
        simulate_drive(
            profile="town", grade="mems_x", duration=400.0, seed=k, imu_rate_hz=10.0, name=f"car{k}"
        ).log
        for k in (11, 12)
    ]


def test_what_the_gyros_have_in_common_is_chosen(logs, make_recipe, tmp_path):
    choice = choose_gyro_terms(logs, make_recipe(methods=("ekf",)))
    assert choice.terms[0] == "scale"
    assert "abs_scale" in choice.terms
    assert set(choice.terms) <= set(CANDIDATES)
    assert choice.drives == ("car11", "car12")
    assert choice.table["chosen"].sum() == len(choice.terms)
    assert (choice.table["reduction"][choice.table["chosen"]] > choice.asked).all()
    path = save_augmented_spec(choice, tmp_path / "fleet.yaml")
    spec = load_spec(path)
    assert isinstance(spec, AugmentedSpec)
    assert (spec.name, spec.gyro_terms) == ("fleet", ("bias", *choice.terms))
    assert "car11, car12" in spec.notes
    with pytest.raises(ConfigError, match="exists already"):
        save_augmented_spec(choice, path)


def test_what_cannot_be_chosen_among_is_refused(make_recipe):
    recipe = make_recipe(methods=("ekf",))
    with pytest.raises(ConfigError, match="0 drives"):
        choose_gyro_terms([], recipe)
    with pytest.raises(ConfigError, match="give drives"):
        choose_gyro_terms([], recipe, candidates=("speed",))
