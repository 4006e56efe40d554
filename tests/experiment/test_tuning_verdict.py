"""Tuned noise is recommended where likelihood gains and outages are not worse."""

import math
from dataclasses import replace

import pandas as pd
import pytest

from navlearn.experiment.baselines import filter_options
from navlearn.experiment.held_out_gain import HeldOutGain
from navlearn.experiment.held_out_outages import (
    OutageGain,
    held_out_outages,
    outage_gain,
    outages_of,
)
from navlearn.experiment.tuning_drives import Stretch
from navlearn.experiment.tuning_verdict import TuningVerdict, judged
from navlearn.learning.noise_options import TuningOptions
from navlearn.logs.drive_log import DriveLog
from navlearn.logs.synthetic import simulate_drive
from navlearn.outages.schedule import OutageProtocol
from navlearn.recipe import Recipe
from navlearn.recipe.log_section import LogSource, SimulatedSection
from navlearn.recipe.sections import MechanizationSection, OutageSection
from navlearn.recipe.tuned_spec import TunedSpec

LIKELIER = HeldOutGain(before=-3.0, after=-1.0, low=1.5, high=2.5, windows=20, seconds=1200.0)
UNCLEAR = replace(LIKELIER, low=-0.5)
LESS_LIKELY = replace(LIKELIER, after=-4.0, low=-2.0, high=-0.5)
UNTOLD = replace(LIKELIER, low=math.nan, high=math.nan)
SHORTER = OutageGain(
    duration=60.0, count=8, before=8.0, after=7.0, improvement=12.5, low=-3.0, high=20.0, failed=0
)
LONGER = replace(SHORTER, after=8.1, improvement=-1.25)


@pytest.mark.parametrize(
    ("likelihood", "outages", "said"),
    [
        (LIKELIER, SHORTER, ""),
        (LIKELIER, replace(SHORTER, after=8.0, improvement=0.0), ""),
        (LIKELIER, LONGER, "outages are worse"),
        (LIKELIER, replace(SHORTER, failed=1), "outages are worse"),
        (LIKELIER, replace(SHORTER, improvement=math.nan), "outages are worse"),
        (LIKELIER, None, "no outage of 60 s fits"),
        (UNCLEAR, SHORTER, "no clear gain in likelihood"),
        (LESS_LIKELY, SHORTER, "the likelihood is worse"),
        (UNTOLD, SHORTER, "too little is held out"),
        (LESS_LIKELY, LONGER, "the likelihood is worse and outages are worse"),
    ],
)
def test_both_must_speak_for_it(
    likelihood: HeldOutGain, outages: OutageGain | None, said: str
) -> None:
    verdict = TuningVerdict(likelihood=likelihood, outages=outages, duration=60.0)
    assert verdict.recommended is (said == "")
    assert verdict.words.startswith("recommended" if said == "" else f"not recommended: {said}")
    assert verdict.figures["recommended"] == int(said == "")
    # both figures stand in the words and in the spec, whichever way it goes
    assert f"{likelihood.before:.3f} -> {likelihood.after:.3f} nats/s" in verdict.words
    assert verdict.figures["held_out_nats_per_s"]["after"] == likelihood.after
    if outages is None:
        assert "held_out_outages" not in verdict.figures
    else:
        assert f"8.00 -> {outages.after:.2f} m" in verdict.words
        assert verdict.figures["held_out_outages"]["after_m"] == outages.after
    told = [x for x in verdict.figures.values() if isinstance(x, dict)]
    assert all(math.isfinite(value) for numbers in told for value in numbers.values())
    TunedSpec(filter={"noise": {"speed_noise": 0.1}}, figures=verdict.figures)


def test_outages_are_compared_pair_by_pair() -> None:
    errors = {"ekf": [4.0, 10.0, 6.0, 5.0], "ekf+tuned": [2.0, 9.0, 4.0, math.nan]}
    rows = pd.DataFrame(
        [
            {"drive": "0", "outage": k + 1, "method": name, "max_horizontal_error_m": error}
            for name, column in errors.items()
            for k, error in enumerate(column)
        ]
    )
    found = outage_gain(rows, 30.0)
    assert (found.count, found.failed) == (3, 1)
    assert found.before == pytest.approx(20.0 / 3.0)
    assert found.after == pytest.approx(5.0)
    assert found.improvement == pytest.approx(25.0)
    assert found.low <= 25.0 <= found.high
    assert not found.not_worse
    assert outage_gain(rows[rows["outage"] < 4], 30.0).not_worse


@pytest.fixture(scope="module")
def log() -> DriveLog:
    return simulate_drive(
        profile="town", grade="mems_m", duration=700.0, seed=13, imu_rate_hz=5.0
    ).log


def _recipe() -> Recipe:
    made = SimulatedSection(grade="mems_m", duration_s=700.0, imu_rate_hz=5.0, seed=13)
    return Recipe(
        name="little",
        log=LogSource(simulated=made),
        methods=("ekf",),
        mechanization=MechanizationSection(rate_hz=5.0),
        outages=OutageSection(count=4, duration_s=60.0, warm_up_s=200.0),
    )


def test_outages_lie_in_what_is_held_out(log: DriveLog) -> None:
    protocol = _recipe().outages.protocol()
    part = Stretch(log=log, fingerprint="", tuned_until=400.0)
    outages = outages_of(protocol, part)
    assert len(outages) == 3
    assert all(one.start >= 400.0 and one.duration == 60.0 for one in outages)
    whole = outages_of(protocol, replace(part, tuned_until=-math.inf))
    assert 200.0 <= whole[0].start < 300.0
    listed = OutageProtocol(placement="listed", times=(100.0, 300.0))
    assert outages_of(replace(listed, duration=60.0), part) == outages
    assert outages_of(protocol, replace(part, tuned_until=660.0)) == ()
    late = held_out_outages(
        _recipe(), [replace(part, tuned_until=660.0)], TunedSpec(filter={"noise": {}})
    )
    assert late is None


def test_what_is_likelier_and_worse_in_outages_is_not_recommended(log: DriveLog) -> None:
    recipe = _recipe()
    before = filter_options(recipe, log=log)
    # fixes hardly err from second to second: believed for good, they are likely, and so is a car
    # that is pushed about; of its gyro the filter then learns the errors of the fixes
    found = {
        "noise": {"position_inflation": 0.5, "velocity_inflation": 0.5, "gyro_bias_walk": 3e-4}
    }
    stretch = Stretch(log=log, fingerprint="", tuned_until=300.0)
    verdict = judged(recipe, [stretch], before, found, TuningOptions())
    assert verdict is not None
    assert verdict.outages is not None
    assert verdict.likelihood.better, verdict.words
    assert verdict.outages.improvement < -5.0, verdict.words
    assert not verdict.recommended
    assert verdict.words.startswith("not recommended: outages are worse: held-out")
    whole = replace(stretch, tuned_until=math.inf)
    assert judged(recipe, [whole], before, found, TuningOptions()) is None
