"""Grades hold the figures they are named after, and draws have those figures."""

import math
from dataclasses import replace

import numpy as np
import pytest

from navlearn.errors import ConfigError
from navlearn.logs.synthetic.figures import AccelerometerGrade, GyroGrade
from navlearn.logs.synthetic.grades import GRADES, find_grade
from navlearn.logs.synthetic.inertial_errors import (
    STANDARD_GRAVITY,
    accelerometer_errors,
    gyro_errors,
    quantise,
    warming,
)

N = 400
INPUTS = np.random.default_rng(0)
RATE = INPUTS.uniform(-0.6, 0.6, (N, 3))
FORCE = INPUTS.normal((0.0, 0.0, 9.8), 1.0, (N, 3))
WARM = np.linspace(0.0, 10.0, N)


def test_white_noise_of_the_classes() -> None:
    arw = {name: g.gyro.angle_random_walk_deg_per_sqrt_h for name, g in GRADES.items()}
    assert arw["mems_l"] == 2.25
    assert arw["mems_m"] == 0.6
    assert arw["ideal"] == 0.0
    assert arw["tactical"] <= 0.125
    assert arw["mems_x"] < arw["mems_m"]
    assert GRADES["mems_x"].gyro.scale_factor_percent == 3.0
    assert GRADES["mems_l"].accelerometer.velocity_random_walk_m_per_s_per_sqrt_h == 0.15
    assert GRADES["low_cost_obd"].odometer.step_kmh == 1.0
    assert all(name == grade.name for name, grade in GRADES.items())


def test_unknown_grade_names_the_known_ones() -> None:
    with pytest.raises(ConfigError, match="found 'mems', expected one of ideal, tactical, mems_l"):
        find_grade("mems")
    custom = replace(GRADES["mems_m"], name="mine")
    assert find_grade(custom) is custom


def test_coefficients_are_drawn_with_their_standard_deviation() -> None:
    grade = GRADES["mems_l"].gyro
    drawn = [
        gyro_errors(RATE[:2], FORCE[:2], WARM[:2], 0.01, grade=grade, seed=s)[2].coefficients
        for s in range(600)
    ]
    expected = {
        "turn_on_bias": math.radians(grade.bias_deg_per_s),
        "scale_factor": grade.scale_factor_percent / 100.0,
        "even": grade.even_percent / 100.0,
        "odd": grade.odd_percent / 100.0,
        "cross_first": grade.cross_axis_percent / 100.0,
        "g_sensitivity_x": math.radians(grade.g_sensitivity_deg_per_s_per_g) / STANDARD_GRAVITY,
        "temperature": math.radians(grade.temperature_deg_per_s_per_k),
    }
    for name, std in expected.items():
        values = np.array([d[name] for d in drawn])
        assert np.std(values) == pytest.approx(std, rel=0.1), name
        assert abs(values.mean()) < 4.0 * std / math.sqrt(600), name


def test_deterministic_error_is_the_stated_function() -> None:
    errors = gyro_errors(RATE, FORCE, WARM, 0.01, grade=GRADES["mems_l"].gyro, seed=9)
    for axis, e in enumerate(errors):
        c = e.coefficients
        first, second = (a for a in range(3) if a != axis)
        w = RATE[:, axis]
        regressors = np.stack(
            [
                np.ones(N),
                w,
                np.abs(w),
                w * np.abs(w),
                RATE[:, first],
                RATE[:, second],
                FORCE[:, 0],
                FORCE[:, 1],
                WARM,
            ],
            axis=-1,
        )
        found = np.linalg.lstsq(regressors, e.deterministic_total(), rcond=None)[0]
        assert found == pytest.approx(list(c.values()), rel=1e-6, abs=1e-12)


def test_reading_is_truth_plus_parts_rounded_to_the_step() -> None:
    grade = GRADES["mems_m"].gyro
    z = gyro_errors(RATE, FORCE, WARM, 0.01, grade=grade, seed=1)[2]
    read = z.apply(RATE[:, 2])
    step = math.radians(grade.step_deg_per_s)
    assert np.abs(read / step - np.round(read / step)).max() < 1e-6
    exact = RATE[:, 2] + sum(z.deterministic.values()) + sum(z.stochastic.values())
    assert np.abs(read - exact).max() <= step / 2.0 * (1.0 + 1e-9)
    assert np.std(read - exact) == pytest.approx(step / math.sqrt(12.0), rel=0.1)


def test_an_axis_keeps_its_draws_when_another_part_changes() -> None:
    grade = GRADES["mems_m"].gyro
    before = gyro_errors(RATE, FORCE, WARM, 0.01, grade=grade, seed=3)
    silent = replace(grade, rate_random_walk_deg_per_h_per_sqrt_h=0.0, scale_factor_percent=0.0)
    after = gyro_errors(RATE, FORCE, WARM, 0.01, grade=silent, seed=3)
    for a, b in zip(before, after, strict=True):
        assert np.array_equal(a.stochastic["white"], b.stochastic["white"])
        assert np.array_equal(a.stochastic["gauss_markov"], b.stochastic["gauss_markov"])
        assert a.coefficients["odd"] == b.coefficients["odd"]
        assert not b.stochastic["random_walk"].any()
    assert not np.array_equal(before[0].stochastic["white"], before[2].stochastic["white"])


def test_accelerometer_parts() -> None:
    grade = AccelerometerGrade(
        bias_mg=10.0,
        scale_factor_percent=1.0,
        quadratic_mg_per_g2=2.0,
        cross_axis_percent=0.5,
        temperature_mg_per_k=0.1,
        step_mg=0.5,
    )
    drawn = [
        accelerometer_errors(FORCE, WARM, 0.1, grade=grade, seed=s)[1].coefficients
        for s in range(400)
    ]
    mg = 1e-3 * STANDARD_GRAVITY
    assert np.std([d["turn_on_bias"] for d in drawn]) == pytest.approx(10.0 * mg, rel=0.1)
    assert np.std([d["quadratic"] for d in drawn]) == pytest.approx(
        2.0 * mg / STANDARD_GRAVITY**2, rel=0.1
    )
    z = accelerometer_errors(FORCE, WARM, 0.1, grade=grade, seed=0)[2]
    c = z.coefficients
    by_hand = (
        c["turn_on_bias"]
        + c["scale_factor"] * FORCE[:, 2]
        + c["quadratic"] * FORCE[:, 2] ** 2
        + c["cross_first"] * FORCE[:, 0]
        + c["cross_second"] * FORCE[:, 1]
        + c["temperature"] * WARM
    )
    np.testing.assert_allclose(z.deterministic_total(), by_hand, rtol=1e-12)


def test_stochastic_parts_have_their_figures() -> None:
    grade = GyroGrade(
        bias_instability_deg_per_h=10.0,
        correlation_time=50.0,
        rate_random_walk_deg_per_h_per_sqrt_h=60.0,
        angle_random_walk_deg_per_sqrt_h=0.6,
    )
    count, dt = 3600, 1.0
    still = np.zeros((count, 3))
    runs = [
        gyro_errors(still, still, still[:, 0], dt, grade=grade, seed=s)[2].stochastic
        for s in range(300)
    ]
    per_h = math.radians(1.0) / 3600.0
    ends = np.array([r["random_walk"][-1] for r in runs])
    assert np.std(ends) == pytest.approx(60.0 * per_h, rel=0.12)
    assert np.std([r["gauss_markov"] for r in runs]) == pytest.approx(10.0 * per_h, rel=0.05)
    # An hour of white noise turns the car by the angle random walk.
    angles = np.array([r["white"].sum() * dt for r in runs])
    assert np.std(angles) == pytest.approx(math.radians(0.6), rel=0.12)


def test_quantise_and_warming() -> None:
    assert quantise(np.array([0.26, -0.26, 0.24]), 0.5) == pytest.approx([0.5, -0.5, 0.0])
    assert quantise(np.array([0.26]), 0.0)[0] == 0.26
    assert warming(np.array([0.0, 900.0, 1e9]), 10.0, 900.0) == pytest.approx(
        [0.0, 10.0 * (1.0 - math.exp(-1.0)), 10.0]
    )
