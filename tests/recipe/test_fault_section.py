"""Faults of a recipe reach the fixes of its log, and nothing else."""

import pytest
import yaml

from navlearn.logs.synthetic import Biases, FaultOptions, Freezes, Ramps, Spikes
from navlearn.recipe.fault_section import FaultSection


def test_left_out_keys_are_the_defaults_of_the_room():
    section = FaultSection(spikes={}, biases={}, ramps={}, freezes={})
    assert section.options() == FaultOptions(
        spikes=Spikes(), biases=Biases(), ramps=Ramps(), freezes=Freezes()
    )


def test_stated_keys_arrive():
    text = """
    spikes: {sizes_m: [5, 50], per_hour: 12, vertical: 0.5, velocity: 2, honest: true}
    ramps: {sizes_m: [80], durations_s: [90], velocity: true}
    freezes: {durations_s: [5], velocity: true}
    settle_s: 10
    apart_s: 0
    seed: 7
    """
    options = FaultSection.model_validate(yaml.safe_load(text)).options(more_seed=100)
    assert options == FaultOptions(
        spikes=Spikes(sizes=(5.0, 50.0), per_hour=12.0, vertical=0.5, velocity=2.0, honest=True),
        ramps=Ramps(sizes=(80.0,), durations=(90.0,), velocity=True),
        freezes=Freezes(durations=(5.0,), velocity=True),
        settle=10.0,
        apart=0.0,
        seed=107,
    )
    assert options.biases is None


@pytest.mark.parametrize(
    "bad",
    [
        {},
        {"spike": {}},
        {"spikes": {"sizes": [3]}},
        {"spikes": {"sizes_m": []}},
        {"biases": {"durations_s": [0]}},
    ],
)
def test_what_no_fault_is_is_refused(bad):
    with pytest.raises(ValueError, match=r"names no kind|Extra inputs|at least 1|greater than"):
        FaultSection.model_validate(bad)
