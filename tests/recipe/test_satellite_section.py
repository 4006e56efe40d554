"""Satellites of a simulated drive in recipes."""

from dataclasses import replace

import pytest
import yaml
from pydantic import ValidationError

from navlearn.logs.synthetic import PRESETS
from navlearn.recipe.log_section import SimulatedSection
from navlearn.recipe.satellite_section import satellite_options
from navlearn.recipe.swept_drives import SimulatedDrives


def test_a_name_is_a_preset_and_a_mapping_is_laid_over_one() -> None:
    assert satellite_options("urban") == PRESETS["urban"]
    given = yaml.safe_load("{preset: urban, systems: [G, E], canyon_share: 0, fixes: drawn}")
    section = SimulatedSection(satellites=given)
    assert section.satellites is not None
    expected = replace(PRESETS["urban"], systems=("G", "E"), canyon_share=0.0, fixes="drawn")
    assert satellite_options(section.satellites) == expected
    bare = SimulatedSection(satellites={"thermal": 0.1}).satellites
    assert bare is not None
    assert satellite_options(bare) == replace(PRESETS["open_sky"], thermal=0.1)
    assert SimulatedSection().satellites is None


def test_what_was_resolved_can_be_read_again() -> None:
    section = SimulatedSection(satellites={"preset": "suburban", "systems": ["G", "R"]})
    written = yaml.safe_load(yaml.safe_dump(section.model_dump(mode="json")))
    again = SimulatedSection(**written)
    assert again == section


def test_the_sky_of_a_sweep_is_the_same_entry() -> None:
    swept = SimulatedDrives(type="simulated", grades=("mems_m",), sky="suburban")
    assert swept.sky == "suburban"
    with pytest.raises(ValidationError, match="did you mean 'suburban'"):
        SimulatedDrives(type="simulated", grades=("mems_m",), sky="suburbia")


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ("downtown", "expected one of open_sky, suburban, urban, ideal"),
        ({"preset": "urbann"}, "did you mean 'urban'"),
        ({"preset": 3}, "preset is 3"),
        ({"thermall": 1.0}, "did you mean 'thermal'"),
        ({"thermal": "much"}, "thermal is 'much'; expected a valid number"),
        ({"thermal": -1.0}, "expected 0 or more"),
        ({"systems": ["GPS"]}, "expected some of G, E, R"),
        ({"fixes": "none"}, "fixes is 'none'"),
    ],
)
def test_refusals(given: object, message: str) -> None:
    with pytest.raises(ValidationError, match=message):
        SimulatedSection(satellites=given)  # type: ignore[arg-type]


def test_the_scenario_of_a_paper_has_no_satellites() -> None:
    with pytest.raises(ValidationError, match="satellites is 'urban'"):
        SimulatedSection(profile="jaradat2017", satellites="urban")
