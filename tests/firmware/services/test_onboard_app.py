"""The sensor application's own pose on a host board: a field of eight known coils and noise, at the converters."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any

import magpylib
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from tests.firmware.apps.test_sensor_app import MATRIX, NODE, ZERO, World, cycle_start
from tests.firmware.host_rig import CHIPS, MS, gold_chips

CODES = list(range(2, 10))
CENTRES = [(x, y, z) for z in (0.0, 1.78) for x in (0.0, 2.13) for y in (0.0, 2.13)]
POSITION = np.array([0.9, 1.2, 0.8])
ATTITUDE = Rotation.from_rotvec([0.3, -0.2, 1.1])
NOISE_T = 2e-7
MOMENT = 190.0 * np.pi * 0.149**2
TABLE = {
    "pose": 1,
    "noise": NOISE_T,
    "code_count": 8,
    "code_list": CODES,
    "survey": [0.0] * 24,
    "gain_sd": 0.0,
    "axis_sd": 0.0,
    "beacons": [float(x) for centre in CENTRES for x in (*centre, 0.0, 0.0, 2.0, MOMENT, 0.149)],
}
OWN = ["POSE_POSITION", "POSE_ATTITUDE", "POSE_QUALITY", "POSE_INTEGRITY"]


def chips_of_field(codes: list[int]) -> np.ndarray:
    """Field in the sensor's frame at each chip, T, without noise."""
    coils = [magpylib.current.Circle(diameter=0.298, current=190.0, position=centre) for centre in CENTRES]
    fields = ATTITUDE.inv().apply([coil.getB(POSITION) for coil in coils] + [np.array([2e-5, 0.0, -4.5e-5])])
    chips = np.array([*(gold_chips(code) for code in codes), np.ones(CHIPS)])
    return np.asarray(chips.T @ fields)


def counts_of(field_T: np.ndarray, noise_T: float = NOISE_T) -> Callable[[int, int], np.ndarray]:
    """Converter counts about mid-scale by cycle and chip."""
    inverse, noise = np.linalg.inv(MATRIX), np.random.default_rng(4).normal(0.0, noise_T, (16, CHIPS, 3))
    return lambda cycle, chip: inverse @ (field_T[chip] + noise[cycle % 16, chip]) + ZERO - 2048


@pytest.fixture
def make() -> Iterator[Callable[..., World]]:
    worlds: list[World] = []

    def create(counts: Callable[[int, int], np.ndarray], **parameters: Any) -> World:
        worlds.append(World(counts, **parameters))
        return worlds[-1]

    yield create
    for world in worlds:
        world.board.close()


def error_of(position: Any, attitude: Any) -> tuple[float, float]:
    """Metres and radians."""
    turn = Rotation.from_quat([attitude.signals[axis] for axis in "xyzw"])
    off = np.array([position.signals[axis] for axis in "xyz"]) - POSITION
    return float(np.linalg.norm(off)), float((turn * ATTITUDE.inv()).magnitude())


def poses_of(world: World) -> list[Any]:
    """The messages of each cycle's pose, in the order of `OWN`."""
    return list(zip(*(world.board.messages(name) for name in OWN), strict=True))


def test_a_pose_follows_the_fields_of_each_cycle(make: Callable[..., World]) -> None:
    world = make(counts_of(chips_of_field(CODES)), **TABLE)
    world.run_cycles(10)
    messages = [m for m in world.board.messages() if m.name not in ("HEARTBEAT", "COUNTER", "CLOCK")]
    starts = [i for i, m in enumerate(messages) if m.name == "EPOCH"]
    for start, end in zip(starts[-5:], [*starts[-4:], None], strict=True):
        cycle = messages[start:end]
        assert [m.name for m in cycle] == ["EPOCH", "EPOCH_STATUS", "EPOCH_OFFSET", *["FIELD"] * 8, *OWN]
        assert all(m.signals["cycle_low"] == cycle[0].signals["cycle"] % 16 for m in cycle[1:])
        quality, integrity = cycle[-2].signals, cycle[-1].signals
        assert (integrity["reason"], integrity["left_out"]) == (0, 255)
        assert 0.02 < integrity["protection"] < 0.5
        assert (quality["status"], quality["tracked"], quality["used"]) == (0, 1, 8)
        assert 0.5 < quality["residual"] < 2.0
        position, attitude = error_of(*cycle[-4:-2])
        assert position < 3.0 * quality["sigma_position"] < 0.03
        assert attitude < 3.0 * quality["sigma_attitude"] < 0.06
    # The cycle is over before its fields can leave: the pose comes within two blocks of them.
    position = [m.name for m in messages].index("POSE_POSITION")
    assert messages[position - 1].name == "FIELD"


def test_switched_on_at_run_time(make: Callable[..., World]) -> None:
    world = make(counts_of(chips_of_field(CODES)), **(TABLE | {"pose": 0}))
    world.board.send_serial("PARAM_SET", {"kind": 0, "value_unsigned": 1}, NODE, 11, cycle_start(7) + 40 * MS)
    world.run_cycles(9)
    poses = world.board.messages("POSE_QUALITY")
    assert [m.signals["tracked"] for m in poses] == [0, 1]  # Those of cycles 7 and 8, the first with no prior.
    assert [m.signals["status"] for m in poses] == [0, 0]
    assert error_of(world.board.messages("POSE_POSITION")[0], world.board.messages("POSE_ATTITUDE")[0])[0] < 0.03


@pytest.mark.parametrize(
    "wrong",
    [
        {"code_list": [*CODES[:7], 1024]},
        {"code_list": [*CODES[:7], 2]},
        {"beacons": TABLE["beacons"][:16]},
    ],
    ids=["code v", "one code twice", "two beacons known"],
)
def test_a_cycle_without_a_pose_says_so(make: Callable[..., World], wrong: dict[str, Any]) -> None:
    codes = wrong.get("code_list", CODES)
    world = make(counts_of(chips_of_field(codes)), **(TABLE | wrong))
    world.run_cycles(8)
    position, attitude, quality, integrity = (world.board.messages(name)[-1].signals for name in OWN)
    assert quality["status"] == 4
    assert [position[axis] for axis in "xyz"] == pytest.approx([-52.4288] * 3)
    assert [attitude[axis] for axis in "xyzw"] == [0.0] * 4
    assert quality["used"] == (2 if "beacons" in wrong else 0)
    assert integrity["reason"] == (1 if "beacons" in wrong else 3)


def test_a_dead_beacon_is_left_out_and_told(make: Callable[..., World]) -> None:
    """Its exclusion takes many turns of the main loop; each cycle gets its pose, and says what is known by then."""
    chips = chips_of_field(CODES)
    coil = magpylib.current.Circle(diameter=0.298, current=190.0, position=CENTRES[5])
    chips = chips - np.outer(gold_chips(CODES[5]), ATTITUDE.inv().apply(coil.getB(POSITION)))
    world = make(counts_of(chips), **TABLE)
    world.run_cycles(10)
    rows = poses_of(world)
    assert len(rows) == len(world.board.messages("EPOCH"))
    reasons = [integrity.signals["reason"] for *_, integrity in rows]
    told = reasons.index(11)
    assert reasons[0] == 14
    assert set(reasons[1:told]) <= {14, 5, 6}  # 5 or 6: what the few chips of the first cycle tell.
    assert told <= 4
    assert reasons[told:] == [11] * (len(reasons) - told)
    assert all(quality.signals["status"] == 3 for *_, quality, _ in rows[:told])
    for row in rows[told:]:
        position, attitude, quality, integrity = row
        assert len({m.signals["cycle_low"] for m in row}) == 1
        assert (quality.signals["status"], quality.signals["used"]) == (0, 7)
        assert (integrity.signals["reason"], integrity.signals["left_out"]) == (11, 5)
        assert error_of(position, attitude)[0] < 0.05


@pytest.mark.parametrize("limit_m", [0.01, 0.5])
def test_above_the_alert_limit_it_is_unverified(make: Callable[..., World], limit_m: float) -> None:
    world = make(counts_of(chips_of_field(CODES)), **(TABLE | {"alert_limit": limit_m}))
    world.run_cycles(8)
    *_, quality, integrity = (world.board.messages(name)[-1].signals for name in OWN)
    assert 0.01 < integrity["protection"] < 0.5
    assert (quality["status"], integrity["reason"]) == ((5, 10) if limit_m == 0.01 else (0, 0))


def test_reversed_axis_is_inconsistent_and_named(make: Callable[..., World]) -> None:
    world = make(counts_of(chips_of_field(CODES) * [1.0, 1.0, -1.0]), **TABLE)
    world.run_cycles(8)
    *_, quality, integrity = (world.board.messages(name)[-1].signals for name in OWN)
    assert (quality["status"], integrity["reason"]) == (3, 4)


def test_saturated_chips_widen_the_uncertainty(make: Callable[..., World]) -> None:
    clean = counts_of(chips_of_field(CODES))

    def saturated(cycle: int, chip: int) -> np.ndarray:
        return clean(cycle, chip) if chip % 50 else np.array([9999.0, 0.0, 0.0])

    sigma = []
    for counts in (clean, saturated):
        world = make(counts, **TABLE)
        world.run_cycles(8)
        sigma.append(world.board.messages("POSE_QUALITY")[-1].signals["sigma_position"])
    # 21 chips of an offset of 50 uT: 0.22 uT on each sum beside 0.006 uT of noise.
    assert sigma[1] > 10.0 * sigma[0]


def test_half_space_decides_between_the_images(make: Callable[..., World]) -> None:
    """The four coils in one plane alone, which have a mirror."""
    flat = TABLE | {"beacons": TABLE["beacons"][:32]}
    counts = counts_of(chips_of_field(CODES), 1e-8)
    for half_space, status, sign in (
        ([0.0] * 6, 1, None),
        ([0.0, 0.0, 0.0, 0.0, 0.0, 1.0], 0, 1.0),
        ([0.0, 0.0, 0.0, 0.0, 0.0, -1.0], 0, -1.0),
    ):
        world = make(counts, **(flat | {"half_space": half_space}))
        world.run_cycles(8)
        position, _, quality, _ = (world.board.messages(name)[-1].signals for name in OWN)
        assert (quality["status"], quality["used"]) == (status, 4)
        assert abs(position["z"]) == pytest.approx(POSITION[2], abs=0.05)
        if sign is not None:
            assert position["z"] * sign > 0.0
