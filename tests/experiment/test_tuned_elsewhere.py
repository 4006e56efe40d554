"""Drives that a filter was tuned on are not judged by."""

from pathlib import Path

import pytest

from navlearn.errors import ConfigError
from navlearn.experiment.drive import open_log
from navlearn.experiment.state_rmse import drive_errors
from navlearn.experiment.tuned_elsewhere import check_tuned, tuned_until
from navlearn.experiment.tuning_drives import Stretch
from navlearn.logs.drive_log import DriveLog
from navlearn.logs.origin import drive_name
from navlearn.logs.synthetic import with_faults
from navlearn.logs.synthetic.degrade import degrade_gyro
from navlearn.logs.synthetic.fault_options import FaultOptions, Spikes
from navlearn.outages.schedule import Outage
from navlearn.recipe import Recipe
from navlearn.recipe.log_section import LogSource
from navlearn.recipe.tuned_spec import TunedOn, TunedSpec

LATE = (Outage(300.0, 20.0), Outage(340.0, 20.0))


def recipe_of(*made_from: TunedOn, methods: tuple[str, ...] = ("ekf", "ekf+tuned")) -> Recipe:
    spec = TunedSpec(filter={"noise": {"turn_noise": 0.01}}, made_from=made_from)
    base = Recipe.model_validate({"name": "one", "log": {"path": "a"}, "methods": ["ekf"]})
    return base.model_copy(update={"tuned": spec, "methods": methods})


def test_outages_in_what_was_tuned_on_are_refused(short_drive: DriveLog) -> None:
    name = short_drive.metadata.name
    early = TunedOn(log=name, until_s=250.0)
    check_tuned(recipe_of(early), short_drive, LATE)
    check_tuned(recipe_of(TunedOn(log="another")), short_drive, LATE)
    with pytest.raises(ConfigError, match=r"begins at 300 s of short, .* up to 310 s"):
        check_tuned(recipe_of(early, TunedOn(log=name, until_s=310.0)), short_drive, LATE)
    with pytest.raises(ConfigError, match="on all of it"):
        check_tuned(recipe_of(TunedOn(log=name)), short_drive, LATE)
    assert tuned_until(recipe_of(TunedOn(log=name), methods=("ekf",)), short_drive) is None


def test_whole_drives_are_judged_after_it(short_drive: DriveLog) -> None:
    name = short_drive.metadata.name
    found = drive_errors(short_drive, recipe_of(TunedOn(log=name, until_s=250.0)))
    assert found["t"].min() >= 250.0
    with pytest.raises(ConfigError, match="tuned on all of it"):
        drive_errors(short_drive, recipe_of(TunedOn(log=name)))
    until = float(short_drive.imu["t"].iloc[-1])
    with pytest.raises(ConfigError, match="tuned on all of it"):
        drive_errors(short_drive, recipe_of(TunedOn(log=name, until_s=until)))


def test_a_part_of_a_drive_and_the_same_with_faults_are_that_drive(short_drive: DriveLog) -> None:
    faulty = with_faults(short_drive, FaultOptions(spikes=Spikes(), seed=3)).log
    worse = degrade_gyro(faulty, "mems_m", 4)
    for made in (faulty, worse):
        assert made.metadata.name != short_drive.metadata.name
        with pytest.raises(ConfigError, match="tuned on"):
            check_tuned(recipe_of(TunedOn(log=short_drive.metadata.name)), made, LATE)
    stretch = Stretch(log=worse, fingerprint="", tuned_until=350.0)
    with pytest.raises(ConfigError, match="tuned on"):
        check_tuned(recipe_of(stretch.made_from), short_drive, LATE)


def test_a_part_that_a_recipe_names_keeps_the_name_of_its_drive(drive_folder: Path) -> None:
    recipe = recipe_of()
    source = LogSource(path=drive_folder, between_s=(10.0, 390.0))
    part = open_log(recipe.model_copy(update={"log": source}))
    assert part.metadata.name.endswith("_10-390s")
    with pytest.raises(ConfigError, match="tuned on"):
        check_tuned(recipe_of(TunedOn(log=drive_name(part.metadata))), part, LATE)
    assert drive_name(part.metadata) == part.metadata.name.removesuffix("_10-390s")
