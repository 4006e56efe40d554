"""Velocity matching: against SciPy, differences, and the truth of simulated drives."""

import math
from dataclasses import replace

import numpy as np
import pytest
import torch
from scipy.spatial.transform import Rotation

from navlearn.attitude import (
    matrix_from_angles,
    matrix_from_quaternion,
)
from navlearn.logs.imu_timeline import imu_timeline
from navlearn.logs.reference import reference_at
from navlearn.logs.synthetic import simulate_drive
from navlearn.mechanization.ins_alignment_result import InsAlignmentOptions
from navlearn.mechanization.matched_alignment import matched_at
from navlearn.mechanization.matching_model import Guess, VelocityFixes, Window, corrected
from navlearn.mechanization.velocity_matching import MatchingOptions, match_velocity, wahba
from navlearn.states import ImuSample

ACCELERATION = MatchingOptions(slip_sigma=math.inf)


def true_attitude(log, time):
    row = reference_at(log, np.array([time])).iloc[0]
    angles = (
        torch.tensor(float(row[name]), dtype=torch.float64) for name in ("azimuth", "pitch", "roll")
    )
    return matrix_from_angles(*angles)


def error_deg(C_lb, truth):
    vector = Rotation.from_matrix((C_lb @ truth.T).numpy()).as_rotvec(degrees=True)
    return np.abs(vector)


def test_wahba_against_scipy():
    rng = np.random.default_rng(2)
    turn = Rotation.random(random_state=5)
    v_b = rng.standard_normal((12, 3)) + np.array([0.0, 0.0, 9.8])
    v_l = turn.apply(v_b) + 0.05 * rng.standard_normal((12, 3))
    weight = rng.uniform(0.5, 2.0, 12)
    expected, _ = Rotation.align_vectors(v_l, v_b, weights=weight)
    found = wahba(*(torch.tensor(x) for x in (v_l, v_b, weight)))
    np.testing.assert_allclose(found, expected.as_matrix(), atol=1e-12)


@pytest.fixture(scope="module")
def window():
    """A made-up window: any motion will do for derivatives."""
    torch.manual_seed(4)
    count = 200
    kind = {"dtype": torch.float64}
    wave = torch.arange(count, **kind).unsqueeze(-1) * 0.05 + torch.arange(3, **kind)
    rate = 0.3 * torch.sin(wave)
    force = torch.cos(0.7 * wave) + torch.tensor([0.0, 0.0, 9.8], **kind)
    flat = torch.zeros(count, **kind)
    samples = ImuSample(flat + 0.05, rate, force, flat, flat, flat)
    end = torch.tensor([-1, 49, 99, 160, 199])
    v_l = 8.0 * torch.rand(5, 3, **kind)
    delay = torch.tensor([0.0, 0.0, -0.02, 0.025, 0.0], **kind)
    fixes = VelocityFixes(end, delay, v_l, torch.full((5, 3), 0.1, **kind))
    lat, height = torch.tensor(0.8, **kind), torch.tensor(60.0, **kind)
    arm = torch.tensor([0.2, -0.5, 1.0], **kind)
    return Window(samples=samples, fixes=fixes, lat=lat, height=height, lever_arm=arm)


def test_derivatives_against_differences(window):
    kind = {"dtype": torch.float64}
    angles = torch.tensor([0.7, 0.05, -0.1], **kind)
    guess = Guess(
        matrix_from_angles(*angles),
        torch.tensor([1.0, 2.0, 0.1], **kind),
        torch.tensor([0.01, -0.02, 0.005], **kind),
        torch.tensor([0.1, -0.05, 0.2], **kind),
        None,
    )
    told = window.predict(guess)
    step = 1e-6
    for k in range(12):
        error = torch.zeros(12, **kind)
        error[k] = step
        after, before = (
            window.predict(corrected(guess, sign * error, told.middle)._replace(C_lb=None))
            for sign in (1.0, -1.0)
        )
        # A guess less its error is the truth.
        slope = (after.v_l - before.v_l) / (2.0 * step)
        assert torch.allclose(slope, told.by_error[..., k], rtol=1e-4, atol=2e-3), k
        turn = after.C_lb @ before.C_lb.transpose(-1, -2)
        phi = torch.stack((turn[:, 1, 2], turn[:, 2, 0], turn[:, 0, 1]), -1) / (2.0 * step)
        prompt = [0, 1, 4, 5]  # attitude is that at the interval's end, however late the fix
        assert torch.allclose(phi[prompt], told.turned[prompt, :, k], rtol=1e-3, atol=2e-3), k


@pytest.mark.parametrize("azimuth", [0.3, 2.5, -1.8])
def test_a_known_attitude_comes_back(window, azimuth):
    """Fixes made by the window's own prediction, then all of it forgotten."""
    kind = {"dtype": torch.float64}
    truth = Guess(
        matrix_from_angles(*torch.tensor([azimuth, 0.03, -0.02], **kind)),
        torch.tensor([3.0, 6.0, 0.2], **kind),
        torch.tensor([2e-3, -1e-3, 3e-3], **kind),
        torch.zeros(3, **kind),
        None,
    )
    for _ in range(4):
        told = window.predict(truth)
        truth = truth._replace(C_lb=told.middle)
        v_l = (told.v_l + told.arm_l)[:-1]
        made = window.fixes._replace(v_l=v_l, sigma=torch.full_like(v_l, 1e-4))
        window = replace(window, fixes=made)
    wide = torch.full((3,), math.radians(0.5), **kind)
    found = match_velocity(window, torch.zeros(3, **kind), wide, ACCELERATION)
    assert error_deg(found.C_lb, told.C_lb[-1]).max() < 0.02
    assert torch.allclose(found.v_l, told.v_l[-1], rtol=0.0, atol=2e-3)
    assert found.misfit < 0.02


@pytest.mark.parametrize("matching", [MatchingOptions(), ACCELERATION])
def test_error_free_sensors_give_the_true_attitude(matching):
    log = simulate_drive(profile="town", grade="ideal", duration=120.0, seed=11).log
    line = imu_timeline(log)
    found = matched_at(
        line.samples, line.fixes, line.timing, 110, InsAlignmentOptions(matching=matching)
    )
    assert found is not None
    truth = true_attitude(log, float(line.t[found.sample]))
    assert error_deg(matrix_from_quaternion(found.state.q_lb), truth).max() < 0.02


@pytest.fixture(scope="module")
def drives():
    made = [
        simulate_drive(profile="town", grade=grade, duration=400.0, seed=seed).log
        for grade, seed in (("tactical", 12), ("mems_m", 11))
    ]
    return [(log, imu_timeline(log)) for log in made]


def test_accuracy_and_honesty_on_simulated_drives(drives):
    """From accelerations alone, every 30 s; sigmas are those of the errors."""
    ratios = []
    for log, line in drives:
        azimuth = []
        for m in range(80, 380, 30):
            found = matched_at(
                line.samples, line.fixes, line.timing, m,
                InsAlignmentOptions(window=30.0, matching=ACCELERATION),
            )  # fmt: skip
            if found is None or float(found.attitude_sigma[2]) > math.radians(3.0):
                continue
            truth = true_attitude(log, float(line.t[found.sample]))
            error = error_deg(matrix_from_quaternion(found.state.q_lb), truth)
            azimuth.append(error[2])
            ratios.append(error / np.degrees(found.attitude_sigma.numpy()))
            assert error[:2].max() < 1.0
        assert len(azimuth) > 6
        assert np.median(azimuth) < 0.7
        assert max(azimuth) < 3.0
    z = np.sqrt(np.mean(np.square(ratios), axis=0))
    assert ((z > 0.3) & (z < 1.6)).all(), z


def test_wild_fixes_are_withstood(drives):
    _, line = drives[1]
    v_e = line.fixes.v_e.clone()
    v_e[[200, 213, 221]] += torch.tensor([8.0, -6.0, 11.0], dtype=torch.float64)
    options = InsAlignmentOptions(window=40.0, matching=ACCELERATION)
    clean = matched_at(line.samples, line.fixes, line.timing, 230, options)
    spoilt = matched_at(line.samples, line.fixes._replace(v_e=v_e), line.timing, 230, options)
    assert clean is not None
    assert spoilt is not None
    moved = error_deg(*(matrix_from_quaternion(x.state.q_lb) for x in (spoilt, clean)))
    assert moved.max() < 1.5


def test_an_antenna_off_the_imu_is_reckoned_with():
    arm = (0.5, -2.0, 1.2)
    log = simulate_drive(profile="town", grade="ideal", duration=100.0, seed=12, lever_arm=arm).log
    line = imu_timeline(log)
    known, ignored = (
        matched_at(
            line.samples, line.fixes, line.timing, 95,
            InsAlignmentOptions(lever_arm=x, matching=ACCELERATION),
        )
        for x in (arm, (0.0, 0.0, 0.0))
    )  # fmt: skip
    assert known is not None
    assert ignored is not None
    time = float(line.t[known.sample])
    truth, row = true_attitude(log, time), reference_at(log, np.array([time])).iloc[0]
    error = [error_deg(matrix_from_quaternion(x.state.q_lb), truth).max() for x in (known, ignored)]
    assert error[0] < 0.02 < error[1]
    assert float(known.state.lat) * 6.37e6 == pytest.approx(row["lat"] * 6.37e6, abs=0.01)
    assert float(known.state.height) == pytest.approx(row["height"], abs=0.01)
