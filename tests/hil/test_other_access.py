"""Time slots and square waves on the boards: set over CAN, sampled raw, separated on the host, located as ever."""

import dataclasses

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from goldfield.access import SiteAccess
from goldfield.drive import NO_CODE, Drive
from goldfield.link.chips import Calibration, ChipAssembler
from goldfield.locate import locate
from goldfield.poses import Fields
from goldfield_protocol.framing import FrameDecoder, encode_frame
from goldfield_protocol.messages import decode, encode

STREAM, WAVEFORM, SLOTS, SLOT, PERIODS = 4, 13, 14, 15, 25
TONES = [1, 2, 3, 4, 5, 7, 8, 9]
WAYS = {
    "tdma": ([{WAVEFORM: 1, SLOTS: 9, SLOT: k} for k in range(8)], [Drive(slot=k) for k in range(8)]),
    "fdma": ([{WAVEFORM: 2, PERIODS: k} for k in TONES], [Drive(periods=k, square=True) for k in TONES]),
}


def unsigned(node, parameter, value):
    return encode("PARAM_SET", {"kind": 0, "value_unsigned": value}, node=node, index=parameter)


def site_with(site, access, drives):
    beacons = [dataclasses.replace(b, code=NO_CODE, drive=d) for b, d in zip(site.beacons, drives, strict=True)]
    return dataclasses.replace(site, beacons=tuple(beacons), access=access, slots=9 if access == "tdma" else 0)


def cycles_of(rig, node, seconds):
    """Raw cycles that the sensor streams, one read in 10 ms of the rig."""
    decoder, assembler = FrameDecoder(), ChipAssembler(1023)
    cycles = []
    for _ in range(round(seconds / 0.01)):
        rig.advance(0.01)
        for frame in decoder.feed(rig.serial_read()):
            message = decode(frame.identifier, frame.data)
            if message is not None and message.node == node:
                cycles += [sums.copy() for sums in assembler.feed(message)]
    return cycles


@pytest.mark.parametrize("name", WAYS)
def test_pose_with_another_access(open_bench, rig_kind, name):
    if rig_kind not in ("emulated", "host"):
        pytest.fail("this test sets the beacons of a simulated bench")
    parameters, drives = WAYS[name]
    bench = open_bench("prigge8", boards="host")
    rig, sensor = bench.rig, bench.scenario.sensor
    for beacon, values in zip(bench.scenario.beacons, parameters, strict=True):
        for parameter, value in values.items():
            rig.can_write(*unsigned(beacon.node, parameter, value))
            rig.advance(0.002)
    rig.advance(1.5)  # soft start: 1023 driven chips
    rig.serial_read()
    rig.serial_write(encode_frame(*unsigned(sensor.node, STREAM, 1)))
    cycles = cycles_of(rig, sensor.node, 1.05)[-8:]
    assert len(cycles) == 8
    assert all(np.isfinite(sums).all() for sums in cycles)

    site = site_with(bench.site, name, drives)
    access, calibration = SiteAccess(site), Calibration(*sensor.correction())
    truth = rig.truth()[-1]
    separations = [access.from_samples(calibration.field_T(sums)) for sums in cycles]
    fields = np.array([separation.field_T for separation in separations])
    sigma = separations[0].sigma_T
    assert fields.std(axis=0, ddof=1).mean() == pytest.approx(sigma.mean(), rel=0.15)

    ids = tuple(beacon.id for beacon in site.beacons)
    pose = locate(site, Fields(0, 0.0, ids, fields.mean(axis=0), sigma / np.sqrt(len(cycles))))
    assert pose.residual < 2.0  # the error of the quiet slot is in all fields alike: not quite the 1 of separate errors
    assert np.linalg.norm(pose.position_m - truth.position_m) < 0.04
    turn = Rotation.from_quat(pose.orientation_xyzw) * Rotation.from_quat(truth.orientation_xyzw).inv()
    assert np.degrees(turn.magnitude()) < 3.0
