"""Emulated outages of a hand-made drive whose errors have a closed form."""

import math
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
import torch
from torch import Tensor

from navlearn.errors import ConfigError, FitError
from navlearn.filters.belief import Belief
from navlearn.fusion.history import FilterHistory
from navlearn.fusion.options import EkfOptions
from navlearn.learning.pseudo_outages import (
    PseudoOutageOptions,
    emulate_outages,
    error_increments,
    select_outages,
    training_windows,
)
from navlearn.logs.resample import riss_timeline
from navlearn.logs.synthetic import simulate_drive
from navlearn.mechanization.alignment import Alignment
from navlearn.mechanization.options import RissOptions
from navlearn.navigator import Navigator, NavigatorOptions, NavigatorRun
from navlearn.states import NavState, RissSample, Trajectory

DT = 0.1
OPTIONS = PseudoOutageOptions(horizon=30.0, every=10.0, settle=20.0)
A, E2 = 6_378_137.0, 0.0066943799901414


def radii(lat: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    w = 1.0 - E2 * np.sin(lat) ** 2
    return A * (1.0 - E2) / w**1.5, A / np.sqrt(w)


def winding(t: np.ndarray) -> np.ndarray:
    return 0.7 + 0.8 * np.sin(0.06 * t)


def straight(t: np.ndarray) -> np.ndarray:
    return np.full_like(t, 0.7)


def hand_made(
    azimuth: Callable[[np.ndarray], np.ndarray] = winding,
    seconds: int = 200,
    speed: float = 10.0,
    gyro_scale: float = 0.0,
    gyro_bias: float = 0.0,
    odometer_scale: float = 0.0,
) -> NavigatorRun:
    """A run whose filter knows the truth; its samples carry the stated errors."""
    t = np.arange(0, seconds / DT + 1).round() * DT
    a = azimuth(t)
    yaw = -np.diff(a) / DT
    lat, lon = np.empty_like(t), np.empty_like(t)
    lat[0], lon[0] = 0.77, -1.33
    v_e, v_n = (np.zeros(t.size - 1) for _ in range(2))
    fine = (np.arange(20) + 0.5) / 20.0 * DT
    for k in range(t.size - 1):
        inside = azimuth(t[k] + fine)
        v_e[k], v_n[k] = speed * np.sin(inside).mean(), speed * np.cos(inside).mean()
        r_m, r_n = radii(lat[k])
        lat[k + 1] = lat[k] + v_n[k] * DT / (r_m + 100.0)
        lon[k + 1] = lon[k] + v_e[k] * DT / ((r_n + 100.0) * np.cos(0.5 * (lat[k] + lat[k + 1])))
    zero = torch.zeros(t.size - 1, dtype=torch.float64)
    samples = RissSample(
        zero + DT,
        torch.tensor(yaw * (1.0 + gyro_scale) + gyro_bias),
        zero + speed * (1.0 + odometer_scale),
        *(zero for _ in range(5)),
    )
    truth = Trajectory(
        *(torch.tensor(x[1:]) for x in (lat, lon)),
        zero + 100.0,
        torch.tensor(a[1:]),
        torch.tensor(v_e),
        torch.tensor(v_n),
        zero,
    )
    end = torch.arange(9, t.size - 1, 10)
    count = len(end)

    def zeros(*shape: int) -> Tensor:
        return torch.zeros(count, *shape, dtype=torch.float64)

    state = NavState(*(channel[end] for channel in truth[:4]))
    belief = Belief(state, zeros(2), zeros(3), zeros(6, 6), zeros(2), zeros(5))
    nothing = zeros(0)
    history = FilterHistory(
        end, torch.arange(count), belief, belief, truth, nothing, nothing, nothing,
        nothing, nothing, "exact", 1,
    )  # fmt: skip
    alignment = Alignment(0, NavState(*(x[0] for x in truth[:4])), 0.0, 0.0, 0.0, 0.0, 0.0)
    return NavigatorRun(1, alignment, samples, history)


@pytest.fixture(scope="module")
def navigator() -> Navigator:
    plane = RissOptions(dimensions=2, earth_rate=False)
    return Navigator(NavigatorOptions(filter=EkfOptions(mechanization=plane)))


def test_an_ideal_drive_has_no_errors(navigator: Navigator) -> None:
    outages = emulate_outages(navigator, hand_made(), OPTIONS)
    for acts_on in ("position", "azimuth_rate"):
        assert error_increments(outages, acts_on).cumsum(-2).abs().max() < 1e-3


def test_a_simulated_ideal_drive_through_the_filter_has_hardly_any() -> None:
    navigator = Navigator(
        NavigatorOptions(filter=EkfOptions(mechanization=RissOptions(dimensions=2)))
    )
    drive = simulate_drive(profile="town", grade="ideal", duration=300.0, seed=2, imu_rate_hz=20.0)
    line = riss_timeline(drive.log, rate_hz=10.0)
    run = navigator.run(line.samples, line.fixes, line.timing)
    outages = emulate_outages(navigator, run, OPTIONS)
    assert len(outages.start_time) >= 10
    assert error_increments(outages, "position").cumsum(-2).abs().max() < 0.5
    assert error_increments(outages, "azimuth_rate").cumsum(-2).abs().max() < math.radians(0.1)


def test_azimuth_error_of_a_known_gyro_error(navigator: Navigator) -> None:
    """Azimuth runs clockwise: a gyro that reads 3 % too much turns 3 % too far."""
    scale, bias = 0.03, 2e-3
    outages = emulate_outages(navigator, hand_made(gyro_scale=scale, gyro_bias=bias), OPTIONS)
    found = error_increments(outages, "azimuth_rate")[..., 0].cumsum(-1).numpy()
    start = outages.start_time.numpy()[:, None]
    since = np.arange(1.0, 31.0)
    turned = winding(start + since) - winding(start)
    np.testing.assert_allclose(found, scale * turned - bias * since, atol=1e-9)


def test_errors_along_and_across_a_straight_road(navigator: Navigator) -> None:
    """2 % too much odometer: ahead; a gyro that reads to the left: to the left, with t²/2."""
    bias = 1e-4
    run = hand_made(straight, odometer_scale=0.02, gyro_bias=bias)
    total = error_increments(emulate_outages(navigator, run, OPTIONS), "position").cumsum(-2)
    since = torch.arange(1.0, 31.0, dtype=torch.float64)
    assert torch.allclose(total[..., 0], (0.02 * 10.0 * since).expand(len(total), -1), atol=2e-2)
    to_the_left = -0.5 * bias * 10.2 * since**2
    # Resolved in the frame of the predicted azimuth, which itself turns: 0.2 m/s · b t · t / 2.
    assert torch.allclose(total[..., 1], to_the_left.expand(len(total), -1), atol=3e-2)


def test_increments_turned_back_sum_to_the_whole_error(navigator: Navigator) -> None:
    run = hand_made(gyro_scale=0.05, gyro_bias=1e-3, odometer_scale=0.01)
    outages = emulate_outages(navigator, run, OPTIONS)
    along, cross = error_increments(outages, "position").numpy().transpose(2, 0, 1)
    azimuth = outages.predicted.azimuth[:, 9::10].numpy()
    east = (along * np.sin(azimuth) + cross * np.cos(azimuth)).sum(-1)
    north = (along * np.cos(azimuth) - cross * np.sin(azimuth)).sum(-1)
    mine, truth = outages.predicted, outages.reference
    r_m, r_n = radii(truth.lat[:, -1].numpy())
    d_lat, d_lon = (mine.lat - truth.lat)[:, -1].numpy(), (mine.lon - truth.lon)[:, -1].numpy()
    np.testing.assert_allclose(north, d_lat * (r_m + 100.0), atol=1e-3)
    middle = np.cos(truth.lat[:, -1].numpy())
    np.testing.assert_allclose(east, d_lon * (r_n + 100.0) * middle, atol=1e-3)
    assert np.abs(east).max() > 5.0


def test_azimuth_may_pass_half_a_turn(navigator: Navigator) -> None:
    outages = emulate_outages(navigator, hand_made(gyro_bias=0.2), OPTIONS)
    total = error_increments(outages, "azimuth_rate")[..., 0].cumsum(-1)
    assert float(total[0, -1]) == pytest.approx(-0.2 * 30.0, abs=1e-9)


def test_nothing_after_the_end_is_seen(navigator: Navigator) -> None:
    run, end = hand_made(gyro_bias=1e-3), 1210
    outages = emulate_outages(navigator, run, OPTIONS, end=end)
    broken = run._replace(
        samples=RissSample(*(torch.where(later(x, end), 1e3, x) for x in run.samples)),
        history=run.history._replace(
            trajectory=Trajectory(
                *(torch.where(later(x, end), torch.nan, x) for x in run.history.trajectory)
            )
        ),
    )
    again = emulate_outages(navigator, broken, OPTIONS, end=end)
    for acts_on in ("position", "azimuth_rate"):
        assert torch.equal(error_increments(outages, acts_on), error_increments(again, acts_on))
    # The last one ends with the very last sample that may be seen.
    assert float(outages.start_time.max()) == pytest.approx(91.0)
    fewer = emulate_outages(navigator, run, OPTIONS, end=end - 1)
    assert float(fewer.start_time.max()) == pytest.approx(81.0)
    too_many = emulate_outages(navigator, broken, OPTIONS, end=end + 100)
    assert torch.isnan(error_increments(too_many, "position")).any()  # the poison would show


def later(channel: Tensor, end: int) -> Tensor:
    return torch.arange(len(channel)) >= end


def test_where_they_start(navigator: Navigator) -> None:
    run = hand_made()
    outages = emulate_outages(navigator, run, OPTIONS, begin=1000.0)
    # The block that ends 21 s after the start is the first whose end lies 20 s or more within.
    assert outages.start_time.tolist() == pytest.approx([1021.0 + 10.0 * k for k in range(15)])
    recent = PseudoOutageOptions(horizon=30.0, settle=20.0, window=60.0)
    assert emulate_outages(navigator, run, recent).start_time.min() == pytest.approx(141.0)
    windows = training_windows(
        select_outages(outages, torch.tensor([2, 5])), ("speed",), "position"
    )
    assert windows.start_time.tolist() == pytest.approx([1041.0, 1071.0])
    assert windows.u.shape == (2, 30, 1)
    assert windows.y.shape == (2, 30, 2)


def test_where_the_filter_itself_had_no_fixes_none_is_emulated(navigator: Navigator) -> None:
    """Without fixes the filter only coasts: the target there would be a false zero."""
    run = hand_made()
    lost = (run.history.end > 1000) & (run.history.end < 1150)  # from 100 to 115 s
    gappy = run._replace(history=run.history._replace(fix=run.history.fix.masked_fill(lost, -1)))
    starts = emulate_outages(navigator, gappy, OPTIONS).start_time
    # 71 s ends at 101 s, before the gap is 3.5 s old; 111 s starts inside it.
    assert starts.tolist() == pytest.approx(
        [21.0, 31.0, 41.0, 51.0, 61.0, 71.0, 121.0, 131.0, 141.0, 151.0, 161.0]
    )
    patient = replace(OPTIONS, max_fix_interval=16.0)
    assert len(emulate_outages(navigator, gappy, patient).start_time) == 15


def test_too_little_past_is_refused(navigator: Navigator) -> None:
    with pytest.raises(FitError, match=r"hold none of 30 s after 20 s"):
        emulate_outages(navigator, hand_made(), OPTIONS, end=400)
    with pytest.raises(FitError, match=r"drives 60 m in 30 s"):
        emulate_outages(navigator, hand_made(straight, speed=1.0), OPTIONS)


@pytest.mark.parametrize(
    ("options", "said"),
    [
        ({"step": 0.0}, "0 < step <= horizon"),
        ({"settle": -1.0}, "settle is -1.0"),
        ({"minimum_distance": float("nan")}, "minimum_distance is nan"),
    ],
)
def test_options_are_checked(options: dict[str, float], said: str) -> None:
    with pytest.raises(ConfigError, match=said):
        PseudoOutageOptions(**options)


def test_unknown_target_is_refused(navigator: Navigator) -> None:
    with pytest.raises(ConfigError, match="'speed'"):
        error_increments(emulate_outages(navigator, hand_made(), OPTIONS), "speed")
