"""What a log tells the filters: the lever arm of its antenna, and what its fixes leave out."""

from dataclasses import replace

from navlearn.experiment.baselines import DeadReckoning, FilterMethod, FilterRuns, filter_options
from navlearn.logs.synthetic.grades import GRADES
from navlearn.logs.synthetic.simulate import simulate_drive
from navlearn.outages.replay import replay
from navlearn.outages.schedule import Outage
from navlearn.recipe import Recipe

ARM = (0.4, 3.0, 1.2)


def recipe(**filter_overrides: object) -> Recipe:
    return Recipe.model_validate(
        {"name": "arm", "log": {"path": "none"}, "methods": ["ekf"], "filter": filter_overrides}
    )


def test_the_recipe_is_heard_before_the_log():
    log = simulate_drive(duration=60.0, imu_rate_hz=10.0, lever_arm=ARM).log
    assert filter_options(recipe(), log=log).lever_arm == ARM
    assert filter_options(recipe(lever_arm=[1.0, 0.0, 0.0]), log=log).lever_arm == (1.0, 0.0, 0.0)
    assert filter_options(recipe()).lever_arm == (0.0, 0.0, 0.0)


def test_solutions_are_those_of_the_imu_not_of_the_antenna():
    log = simulate_drive(
        profile="town", grade=GRADES["ideal"], duration=400.0, imu_rate_hz=10.0, lever_arm=ARM
    ).log
    forgotten = replace(log, metadata=replace(log.metadata, lever_arm=(0.0, 0.0, 0.0)))
    error = {}
    for name, drive in (("known", log), ("forgotten", forgotten)):
        runs = FilterRuns(recipe())
        methods = {"dead_reckoning": DeadReckoning(recipe()), "ekf": FilterMethod(runs, "ekf")}
        rows = replay(drive, [Outage(300.0, 20.0)], methods, progress=False).rows
        error[name] = rows.set_index("method")["first_horizontal_error_m"]
    assert (error["known"] < 0.5).all()
    assert (error["forgotten"] > 2.0).all()


def test_fixes_without_vertical_velocity_are_not_read_as_zero():
    log = simulate_drive(
        profile="hills", grade=GRADES["tactical"], duration=500.0, imu_rate_hz=10.0
    ).log
    level = replace(log, fixes=log.fixes.drop(columns="v_u"))
    assert filter_options(recipe(), log=log).vertical_velocity
    assert not filter_options(recipe(), log=level).vertical_velocity
    assert filter_options(recipe(vertical_velocity=True), log=level).vertical_velocity
    in_3d = recipe().model_copy(
        update={"mechanization": recipe().mechanization.model_copy(update={"dims": 3})}
    )
    error = {}
    for name, overrides in (("left out", {}), ("read as zero", {"vertical_velocity": True})):
        chosen = in_3d.model_copy(update={"filter": overrides})
        methods = {"ekf": FilterMethod(FilterRuns(chosen), "ekf")}
        rows = replay(level, [Outage(420.0, 40.0)], methods, progress=False).rows
        error[name] = float(rows["max_height_error_m"].iloc[0])
    assert error["left out"] < 0.7 * error["read as zero"]
