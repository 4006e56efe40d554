"""What vehicles answer a tight filter: derivatives by automatic ones, and the loosely coupled."""

from functools import lru_cache
from typing import Any

import pytest
import torch
from torch import Tensor

from navlearn.attitude import quaternion_from_angles
from navlearn.errors import ConfigError
from navlearn.filters.belief import Belief
from navlearn.filters.ekf import propagated
from navlearn.filters.ins_belief import InsBelief
from navlearn.frames import enu_between
from navlearn.fusion.error_state import initial_belief
from navlearn.fusion.gated_update import gated_update
from navlearn.fusion.ins.loosely_coupled import InsEkf
from navlearn.fusion.ins.options import InsEkfOptions
from navlearn.fusion.ins.start import initial_ins_belief
from navlearn.fusion.loosely_coupled import LooselyCoupledEkf
from navlearn.fusion.options import EkfOptions
from navlearn.fusion.recursion import stacked
from navlearn.fusion.tight.ins_vehicle import InsVehicle
from navlearn.fusion.tight.riss_vehicle import RissVehicle
from navlearn.fusion.tight.trees import block_at
from navlearn.fusion.tight.vehicle import Antenna, blocks_in_turn
from navlearn.logs.imu_timeline import ImuTimeline, imu_timeline
from navlearn.logs.synthetic import simulate_drive
from navlearn.mechanization.options import RissOptions
from navlearn.states import FixTiming, GnssFix, ImuSample, InsState, NavState, RissSample

ARM = (0.5, -1.2, 1.7)
TERMS = ("scale", "delay", "offset")
PLANE = RissOptions(dimensions=2)
RISS = {
    "default": EkfOptions(),
    "arm": EkfOptions(lever_arm=ARM, speed_terms=TERMS, gyro_terms=("bias", "scale")),
    "plane": EkfOptions(lever_arm=ARM, mechanization=PLANE),
    "bias_free": EkfOptions(model="bias_free", lever_arm=ARM),
    "shen2010": EkfOptions(model="shen2010", lever_arm=ARM),
    "shen2010_full": EkfOptions(model="shen2010_full", lever_arm=ARM),
}
INS = {n: InsEkfOptions(states=n, lever_arm=ARM) for n in (9, 15, 21)}


def vector(*values: float) -> Tensor:
    return torch.tensor(values, dtype=torch.float64)


def riss_samples(n: int = 50) -> RissSample:
    one = torch.ones(n, dtype=torch.float64)
    wave = torch.sin(torch.arange(n, dtype=torch.float64))
    speed = 12.0 + torch.linspace(0.0, 1.5, n, dtype=torch.float64)
    return RissSample(
        0.02 * one, 0.3 + 0.05 * wave, speed, 0.05 * one, 0.03 * one, wave, wave, 0.0 * one
    )


def imu_samples(n: int = 50) -> ImuSample:
    one = torch.ones(n, 1, dtype=torch.float64)
    wave = 1.0 + 0.1 * torch.sin(torch.arange(n, dtype=torch.float64)).unsqueeze(-1)
    speed, there = 100.0 * one[:, 0], one[:, 0]
    omega, force = vector(0.05, -0.03, 0.3) * wave, vector(2.0, 1.5, 9.9) * wave
    return ImuSample(0.02 * there, omega, force, speed, there, 0.0 * there)


def riss_belief(options: EkfOptions) -> Belief:
    state = NavState(*vector(0.8, 0.1, 200.0, 0.7).unbind())
    sensor = {"gyro_bias": 0.01, "speed_scale": 0.03, "speed_delay": 0.05, "pitch_bias": 0.02}
    belief = initial_belief(options, state, sensor=sensor)
    if options.has_velocity_states:
        belief = belief._replace(velocity_offset=vector(0.3, -0.2, 0.1))
    return belief


def ins_belief(options: InsEkfOptions) -> InsBelief:
    attitude = quaternion_from_angles(*vector(0.7, 0.1, -0.05).unbind())
    state = InsState(*vector(1.05, 0.3, 500.0).unbind(), vector(60.0, 80.0, 3.0), attitude)
    sensor = {"gyro_bias": vector(0.01, -0.02, 0.03), "accel_bias": vector(0.1, 0.2, -0.3)}
    return initial_ins_belief(options, state, sensor=sensor)


def case(name: str | int) -> tuple[Any, Any, Any]:
    """A vehicle, its belief, and a block of 50 samples that ends in the middle of a bend."""
    samples: Any
    if isinstance(name, int):
        vehicle: Any = InsVehicle(INS[name])
        belief: Any = ins_belief(vehicle.options)
        samples = imu_samples()
    else:
        vehicle = RissVehicle(RISS[name])
        belief = riss_belief(vehicle.options)
        samples = riss_samples()
    one = type(samples)(*(x.unsqueeze(0) for x in samples))
    timing = FixTiming(torch.tensor([[len(samples.dt) - 1]]), vector(0.0).unsqueeze(0))
    block = block_at(vehicle.all_blocks(vehicle.laid_out(one, None, timing)), 0)
    return vehicle, belief, squeezed(block)


def squeezed(tree: Any) -> Any:
    return tree[0] if isinstance(tree, Tensor) else type(tree)(*map(squeezed, tree))


# velocity states stand for an interval's mean, whose turn during the lag is not their own
DELAYED = [name for name in (*RISS, *INS) if not str(name).startswith("shen")]


@pytest.mark.parametrize(
    ("name", "delay"), [(n, 0.0) for n in (*RISS, *INS)] + [(n, 0.15) for n in DELAYED]
)
def test_derivatives_of_the_antenna_are_automatic_ones(name: str | int, delay: float) -> None:
    vehicle, belief, block = case(name)
    lag = vector(delay)[0]
    here: Antenna = vehicle.antenna(belief, block, lag)

    def moved(correction: Tensor) -> tuple[Tensor, Tensor]:
        there = vehicle.antenna(vehicle.moved(belief, correction, block), block, lag)
        way = enu_between(there.lat, there.lon, there.height, here.lat, here.lon, here.height)
        return torch.stack(way), there.velocity

    zero = torch.zeros(len(vehicle.names), dtype=torch.float64)
    position, velocity = torch.func.jacrev(moved)(zero)
    torch.testing.assert_close(here.position_by_error, position, atol=2e-4, rtol=1e-4)
    torch.testing.assert_close(here.velocity_by_error, velocity, atol=2e-4, rtol=1e-4)


@pytest.mark.parametrize("name", [*RISS, *INS])
def test_a_correction_of_any_size_is_found_again(name: str | int) -> None:
    vehicle, belief, block = case(name)
    n = len(vehicle.names)
    g = torch.Generator().manual_seed(1)
    correction = torch.randn(n, generator=g, dtype=torch.float64)
    correction[:3] *= 5000.0
    found = -vehicle.difference(belief, vehicle.moved(belief, correction, block), block)
    torch.testing.assert_close(found, correction, rtol=0.0, atol=1e-8)


@pytest.mark.parametrize("name", ["default", 15])
def test_the_antenna_moves_with_its_velocity(name: str | int) -> None:
    vehicle, belief, block = case(name)
    step = 0.01
    late, early = (vehicle.antenna(belief, block, vector(x)[0]) for x in (0.0, step))
    way = torch.stack(enu_between(*late[:3], *early[:3]))
    middle = vehicle.antenna(belief, block, vector(0.5 * step)[0])
    assert float((way / step - middle.velocity).norm()) < 2e-3
    assert float(middle.velocity.norm()) > 10.0


@pytest.mark.parametrize("name", ["default", "arm", "shen2010_full", 9, 15, 21])
def test_a_block_is_what_its_samples_are_in_turn(name: str | int) -> None:
    vehicle, belief, block = case(name)
    at_once = vehicle.predicted(belief, block)
    in_turn = vehicle.predicted_in_turn(belief, block)
    way = enu_between(*at_once.belief.state[:3], *in_turn.belief.state[:3])
    assert float(torch.stack(way).norm()) < 2e-3
    assert float((at_once.transition - in_turn.transition).abs().max()) < 0.05
    sigma = in_turn.noise.diagonal().sqrt().clamp(min=1e-12)
    assert float(((at_once.noise - in_turn.noise) / (sigma[:, None] * sigma)).abs().max()) < 0.06
    assert torch.equal(at_once.belief.covariance, belief.covariance)


def test_an_open_loop_is_refused() -> None:
    with pytest.raises(ConfigError, match="fed back"):
        RissVehicle(EkfOptions(feedback="open"))
    with pytest.raises(ConfigError, match="fed back"):
        InsVehicle(InsEkfOptions(feedback="open"))


def test_hills_surprise_only_a_car_that_moves_in_two_dimensions() -> None:
    up = {}
    for name in ("plane", "default"):
        vehicle, belief, block = case(name)
        up[name] = float(vehicle.antenna(belief, block, vector(0.0)[0]).velocity_variance[2])
        end = block.occasion.end
        still = end._replace(sample=end.sample._replace(stationary=vector(1.0)[0]))
        parked = block._replace(occasion=block.occasion._replace(end=still))
        quiet = vehicle.antenna(belief, parked, vector(0.0)[0]).velocity_variance
        assert float(quiet[2]) == float(quiet[0]) == pytest.approx(0.1**2)
    assert up["plane"] == pytest.approx(3.0**2 + 0.1**2)
    assert up["default"] == pytest.approx(0.1**2 + 0.1**2)


def run_by_hand(vehicle: Any, start: Any, samples: Any, fixes: GnssFix, timing: FixTiming) -> Any:
    """The loosely coupled filter as a loop over what a vehicle answers."""
    line = vehicle.laid_out(samples, fixes, timing)
    after, belief = [], start
    for block in blocks_in_turn(vehicle, line):
        ahead = vehicle.predicted(belief, block)
        P = propagated(belief.covariance, ahead.transition, ahead.noise)
        found = vehicle.measured(ahead.belief, block)
        new, judged = gated_update(
            vehicle,
            P,
            belief.refused,
            found,
            lambda v, f=found: vehicle.opened(v, f, f.innovation),  # type: ignore[misc]
        )
        belief = ahead.belief._replace(covariance=new.covariance, refused=judged.refused)
        belief = vehicle.moved(belief, new.correction, block)
        after.append(belief)
    return stacked(after), vehicle.path(start, stacked(after), line)


@lru_cache(maxsize=1)
def imu_drive() -> tuple[InsState, ImuTimeline]:
    """Forty seconds of town without sensor errors, and the state before them."""
    log = simulate_drive(
        profile="town", grade="ideal", duration=40.0, seed=11, imu_rate_hz=50.0, standstill=5.0
    ).log
    assert log.reference is not None
    first = log.reference.iloc[0]
    line = imu_timeline(log)
    angles = vector(*(float(first[name]) for name in ("azimuth", "pitch", "roll")))
    where = vector(*(float(first[name]) for name in ("lat", "lon", "height")))
    velocity = vector(*(float(first[name]) for name in ("v_e", "v_n", "v_u")))
    start = InsState(*where.unbind(), velocity, quaternion_from_angles(*angles.unbind()))
    return start, line


def wild(fixes: GnssFix) -> GnssFix:
    """Fixes of which a dozen in a row are 300 m off, so that the gate refuses and resets."""
    lat = fixes.lat.clone()
    lat[..., 12:24] += 5e-5
    return fixes._replace(lat=lat)


@pytest.mark.filterwarnings("ignore:filter:UserWarning")  # the fixes are wild
@pytest.mark.parametrize("model", ["bias_scale", "shen2010_full"])
def test_with_fixes_a_riss_vehicle_is_the_loosely_coupled_filter(
    make_drive: Any, model: str
) -> None:
    options = EkfOptions(model=model, lever_arm=ARM)
    d = make_drive(batch=2)
    start = initial_belief(options, d.start)
    job = (start, d.samples, wild(d.fixes), d.timing)
    expected = LooselyCoupledEkf(options)(*job)
    assert int(expected.resets.sum()) > 0
    after, path = run_by_hand(RissVehicle(options), *job)
    torch.testing.assert_close(after.covariance, expected.belief.covariance, atol=0.0, rtol=0.0)
    torch.testing.assert_close(path.lat, expected.trajectory.lat, atol=0.0, rtol=0.0)


@pytest.mark.filterwarnings("ignore:filter:UserWarning")  # the fixes are wild
@pytest.mark.parametrize("states", [9, 15, 21])
def test_with_fixes_an_ins_vehicle_is_the_loosely_coupled_filter(states: int) -> None:
    options = InsEkfOptions(states=states)
    state, line = imu_drive()
    start = initial_ins_belief(options, state)
    job = batched((start, line.samples, wild(line.fixes), line.timing))
    expected = InsEkf(options)(*job)
    assert int(expected.resets.sum()) > 0
    after, path = run_by_hand(InsVehicle(options), *job)
    torch.testing.assert_close(after.covariance, expected.belief.covariance, atol=0.0, rtol=0.0)
    torch.testing.assert_close(path.v_l, expected.trajectory.v_l, atol=0.0, rtol=0.0)


def batched(tree: Any) -> Any:
    if isinstance(tree, Tensor):
        return tree.unsqueeze(0)
    parts = map(batched, tree)
    return type(tree)(*parts) if hasattr(tree, "_fields") else tuple(parts)
