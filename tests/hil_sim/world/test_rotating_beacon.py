"""A beacon of two coils in the rig: currents by numerical integration, fields by the elliptic integrals of a loop."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from scipy.special import ellipe, ellipk

from goldfield import site as sites
from goldfield.access import SiteAccess
from goldfield.errors import UserError
from goldfield.locate import locate
from goldfield.types import Fields
from hil_sim import clib, scenario
from hil_sim.rig import Rig
from tests.hil_sim.rig.fakes import FakeBoards, write_scenario
from tests.hil_sim.world.circuit import integrate

MU0 = 1.25663706127e-6
TURNS, RADIUS_M, AMPLITUDE_A = 19.0, 0.149, 10.0
COSINE_AXIS, SINE_AXIS = np.array([0.6, 0.0, 0.8]), np.array([0.0, 1.0, 0.0])
CYCLE, CHIP_S, FAKE_BURST = 31, 97.75e-6, 8  # of the fake board
LAG_S = 1.0 / (2.0 * np.pi * 1e5)
SPAN_S = 5e-3
CIRCUITS = {
    "follows": {"inductance_H": 1.9e-4, "resistance_Ohm": 0.15, "supply_V": 120.0},
    "cannot follow": {"inductance_H": 2.8e-3, "resistance_Ohm": 0.7, "supply_V": 24.0},  # 8.6 A/ms; the sine needs 21
}


def rotating(directory, **replacements):
    """The small scenario with one beacon, of two coils; no noise."""
    drive = "2\nrotating_periods = 1\naxis = [0.6, 0.0, 0.8]\nsecond_axis = [0.0, 1.0, 0.0]"
    quiet = "0.0\nconverter_noise_LSB = 0.0\npose = 0"
    path = write_scenario(directory, code=drive, noise_T=quiet, **replacements)
    head, beacon, *_ = path.read_text().split("[[beacon]]")
    path.write_text(f"{head}[[beacon]]{beacon}")
    return scenario.load(path)


def loop_field(axis, point):
    """Tesla per ampere of a loop around the origin, shape (3,): Jackson, 5.5, with the complete elliptic integrals."""
    height = point @ axis
    across = point - height * axis
    rho = np.linalg.norm(across)
    near, far = (RADIUS_M - rho) ** 2 + height**2, (RADIUS_M + rho) ** 2 + height**2
    k, e = ellipk(4 * RADIUS_M * rho / far), ellipe(4 * RADIUS_M * rho / far)
    scale = MU0 * TURNS / (2 * np.pi * np.sqrt(far))
    along = scale * (k + (RADIUS_M**2 - rho**2 - height**2) / near * e)
    radial = scale * height / rho * (-k + (RADIUS_M**2 + rho**2 + height**2) / near * e)
    return along * axis + radial * across / rho


@pytest.mark.parametrize("name", CIRCUITS)
def test_both_coils_carry_their_sinusoids_and_the_sensor_sees_both(tmp_path, name):
    circuit = CIRCUITS[name]
    changed = {key: str(value) for key, value in circuit.items()}
    changed["supply_V"] += "\nsense_noise_A = 0.0"
    boards = FakeBoards(periods={1: 1})
    with Rig(rotating(tmp_path, **changed), boards) as rig:
        rig.watch_pins()
        rig.advance(SPAN_S)
        start_s = rig.pin_changes(1)["time_ps"].min() * 1e-12
        looks, samples = boards.samples(1), boards.samples(0)
        rig.close()
    chips = np.arange(int((SPAN_S - start_s) / CHIP_S) + 1)
    angle = 2 * np.pi * chips / CYCLE
    times = [looks["time_ps"] * 1e-12, samples["time_ps"][samples["time_ps"] < SPAN_S * 1e12] * 1e-12]
    every = np.concatenate(times)
    solved = [
        integrate(list(zip(start_s + chips * CHIP_S, targets, strict=True)), SPAN_S, every, lag_s=LAG_S, **circuit)
        for targets in (AMPLITUDE_A * np.cos(angle), AMPLITUDE_A * np.sin(angle))
    ]
    # Each channel's sense, at the moments at which the board looked.
    for channel, solution in enumerate(solved):
        sensed = (looks["volts"][:, channel] - 1.65) / 0.103125
        np.testing.assert_allclose(sensed, solution[: len(looks), 0], atol=1e-5)
    if name == "cannot follow":
        assert np.abs(solved[1][: len(looks), 0]).max() < 0.8 * AMPLITUDE_A  # so the supply's limit was seen at work
    # The sensor: earth and both coils, each behind the low-pass.
    place = np.array([0.5, 0.6, 0.4])
    field = np.tile([2e-5, 0.0, -4.5e-5], (len(times[1]), 1))
    for solution, axis in zip(solved, (COSINE_AXIS, SINE_AXIS), strict=True):
        field += solution[len(looks) :, 1][:, None] * loop_field(axis, place)
    seen = Rotation.from_rotvec([0.1, -0.2, 0.3]).inv().apply(field)
    got = (samples["volts"][: len(seen)] / 1.65 - 1.0) * 2e-4
    assert len(seen) > 300
    np.testing.assert_allclose(got, seen, atol=1e-12)  # of 0.6 uT that a coil makes


def test_the_field_turns_at_the_settled_ends_of_chips(tmp_path):
    boards = FakeBoards(periods={1: 1})
    with Rig(rotating(tmp_path, earth_T="[0.0, 0.0, 0.0]", bandwidth_Hz="0.0"), boards) as rig:
        rig.advance(0.02)
        looks = boards.samples(1)[2 * CYCLE : 6 * CYCLE]
        rig.close()
    angle = 2 * np.pi * np.arange(len(looks)) / CYCLE
    noise_A = 4 * 0.005
    np.testing.assert_allclose((looks["volts"][:, 0] - 1.65) / 0.103125, AMPLITUDE_A * np.cos(angle), atol=noise_A)
    np.testing.assert_allclose((looks["volts"][:, 1] - 1.65) / 0.103125, AMPLITUDE_A * np.sin(angle), atol=noise_A)
    # Two amplifiers, two noises.
    errors = [looks["volts"][:, 0] - 0.103125 * AMPLITUDE_A * np.cos(angle)]
    errors += [looks["volts"][:, 1] - 0.103125 * AMPLITUDE_A * np.sin(angle)]
    assert abs(np.corrcoef(errors)[0, 1]) < 0.4


def test_what_the_site_file_says_is_what_the_sensor_sees(tmp_path):
    """From the rig's samples to a pose: the host knows nothing but the site file that the scenario writes."""
    path = write_scenario(tmp_path, seed="7\ndegree = 5", power_on_spread_s="0.0", noise_T="1e-9\npose = 0")
    text = path.read_text().replace("crystal_ppm", "internal_ppm")  # all chips at once
    for code, second in ((2, "[0.0, 1.0, 0.0]"), (3, "[0.6, 0.8, 0.0]"), (4, "[1.0, 0.0, 0.0]")):
        turning = f"axis = [0.0, 0.0, 1.0]\nsecond_axis = {second}\nrotating_periods = {code - 1}"
        text = text.replace(f"code = {code}", turning)
    path.write_text(text)
    scene = scenario.load(path)
    (tmp_path / "site.toml").write_text(scenario.site_toml(scene))
    site = sites.load(tmp_path / "site.toml")
    boards = FakeBoards(periods={1: 1, 2: 2, 3: 3})
    with Rig(scene, boards) as rig:
        rig.advance(0.02)
        volts = boards.samples(0)["volts"].reshape(-1, FAKE_BURST, 3).mean(axis=1)
        rig.close()
    separation = SiteAccess(site).from_samples((volts[CYCLE : 2 * CYCLE] / 1.65 - 1.0) * 2e-4)
    ids = tuple(beacon.id for beacon in site.beacons)
    assert ids == ("a.cos", "a.sin", "b.cos", "b.sin", "c.cos", "c.sin")
    pose = locate(site, Fields(0, 0.0, ids, separation.field_T, separation.sigma_T))
    np.testing.assert_allclose(pose.position_m, [0.5, 0.6, 0.4], atol=1e-3)
    turned = Rotation.from_quat(pose.orientation_xyzw) * Rotation.from_rotvec([0.1, -0.2, 0.3]).inv()
    assert turned.magnitude() < 2e-3


def test_the_coils_of_zheng6_follow_their_sinusoids():
    """Each step of the set-point has arrived 10 us after the chip's edge, in both coils of every beacon."""
    ffi, library = clib.load("build/libgf_rig.so", ["world/coil.h"])
    loaded = scenario.load_scenario("zheng6")
    chip_ps = 97750000
    for beacon in loaded.beacons:
        circuit = beacon.circuit
        config = {"inductance_H": circuit.inductance_H, "resistance_Ohm": circuit.resistance_Ohm}
        config |= {"supply_V": circuit.supply_V, "reference_A_per_V": 16.0 / 3.3}
        turn = 2 * np.pi * beacon.rotating_periods * np.arange(2 * loaded.chips) / loaded.chips
        for wave in (np.cos(turn), np.sin(turn)):
            coil = ffi.new("coil_t *")
            library.coil_init(coil, ffi.new("coil_config_t *", config))
            library.coil_enable(coil, True, 0)
            short_A = []
            for chip, target_A in enumerate(circuit.current_A * wave):
                library.coil_reference(coil, abs(target_A) / 16.0 * 3.3, chip * chip_ps)
                library.coil_input(coil, 1, bool(target_A > 0.0), chip * chip_ps)
                library.coil_input(coil, 2, bool(target_A < 0.0), chip * chip_ps)
                short_A.append(library.coil_current(coil, chip * chip_ps + 10**7) - target_A)
            assert np.abs(short_A[100:]).max() < 1e-9  # the first step is the whole 8 A


def test_one_enable_and_one_fault_serve_both_coils(tmp_path):
    with Rig(rotating(tmp_path), FakeBoards(periods={1: 1})) as rig:
        rig.advance(0.0155)
        assert np.hypot(rig.coil_current_A(1), rig.coil_current_A(1, 1)) == pytest.approx(AMPLITUDE_A, rel=0.02)
        rig.fault(1, "driver")
        rig.advance(0.001)
        assert [rig.coil_current_A(1, coil) for coil in (0, 1)] == [0.0, 0.0]


def test_one_coil_breaks_alone(tmp_path):
    boards = FakeBoards(periods={1: 1})
    with Rig(rotating(tmp_path), boards) as rig:
        rig.fault(1, "coil_open", coil=1)
        rig.fault(1, "sense_shorted", coil=0)
        rig.advance(0.02)
        looks = boards.samples(1)["volts"][-CYCLE:]
        assert np.all(looks[:, 0] == 0.0)
        assert np.abs(looks[:, 1] - 1.65).max() < 5 * 0.005 * 0.103125
        assert rig.coil_current_A(1, 1) == 0.0
        with pytest.raises(UserError, match="beacon a has 2 coils: there is no coil 2"):
            rig.fault(1, "coil_open", coil=2)
        with pytest.raises(UserError, match="the sensor has 0 coils"):
            rig.coil_current_A(0)
