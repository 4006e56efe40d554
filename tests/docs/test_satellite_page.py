"""The page of simulated satellites states the presets that the code has."""

import dataclasses
from pathlib import Path

from navlearn.logs.synthetic import PRESETS, SatelliteOptions

PAGE = Path(__file__).resolve().parents[2] / "docs" / "simulated_satellites.md"


def as_written(value: object) -> str:
    if isinstance(value, tuple):
        return f"[{', '.join(value)}]"
    return "null" if value is None else f"{value:g}" if isinstance(value, float) else str(value)


def test_page_shows_every_option_of_every_preset() -> None:
    options = PAGE.read_text(encoding="utf-8").split("## Options")[1]
    lines = [line for line in options.splitlines() if line[:1] == "|"]
    rows = [[cell.strip().strip("`") for cell in line.strip("|").split("|")] for line in lines]
    skies = rows[0][1:-1]
    assert set(skies) == set(PRESETS) - {"ideal"}
    names = [field.name for field in dataclasses.fields(SatelliteOptions)]
    assert [row[0] for row in rows[2:]] == names
    for row in rows[2:]:
        shown = dict(zip(skies, row[1:], strict=False))
        for sky in skies:
            assert shown[sky] == as_written(getattr(PRESETS[sky], row[0])), row[0]


def test_the_presets_keep_figures_that_the_page_states_of_them() -> None:
    ideal, open_sky = PRESETS["ideal"], PRESETS["open_sky"]
    assert open_sky == SatelliteOptions()
    changed = {
        field.name
        for field in dataclasses.fields(SatelliteOptions)
        if getattr(ideal, field.name) != getattr(open_sky, field.name)
    }
    assert changed == {
        "fading",
        "thermal",
        "rate_thermal",
        "ionosphere",
        "troposphere",
        "orbit",
        "multipath",
    }
    assert not any(getattr(ideal, name) for name in changed)
    assert not any(preset.systematic for preset in PRESETS.values())
