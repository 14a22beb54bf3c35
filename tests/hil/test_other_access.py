"""Time slots, square waves and superposed codes on the boards: sampled raw, separated on the host, located as ever."""

import contextlib

import numpy as np
import pytest

from goldfield.access import SiteAccess
from goldfield.link.chips import Calibration, ChipAssembler
from goldfield.locate import locate
from goldfield.types import Fields
from goldfield_protocol.framing import FrameDecoder, encode_frame
from goldfield_protocol.messages import decode, encode
from goldfield_protocol.parameters import PARAMETERS
from hil_sim.bench import SimulatedBench
from tests.hil.bound import bound_of_alike, check_at_the_bound

CYCLES = 20
PARAM_STREAM = PARAMETERS["stream"].first


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


def recorded(scenario, boards, directory):
    """Return the site, the sensor's calibration, some raw cycles and the truth of a bench."""
    with contextlib.closing(SimulatedBench(scenario, boards, directory)) as bench:
        rig, sensor = bench.rig, bench.scenario.sensor
        rig.serial_read()  # the longest soft start, of a slot at a time, was over 0.9 s before the bench's start
        request = encode("PARAM_SET", {"kind": 0, "value_unsigned": 1}, node=sensor.node, index=PARAM_STREAM)
        rig.serial_write(encode_frame(*request))
        cycles = cycles_of(rig, sensor.node, 0.1 * CYCLES + 0.25)[-CYCLES:]
        return bench.site, Calibration(*sensor.correction()), cycles, rig.truth()[-1]


@pytest.mark.parametrize("scenario", ["slots8", "tones8", "superposed"])
def test_pose_with_another_access(tmp_path, scenario):
    check_pose(tmp_path, scenario, "host")


@pytest.mark.slow
def test_pose_with_superposed_codes_of_emulated_boards(tmp_path):
    check_pose(tmp_path, "superposed", "emulated")


def check_pose(tmp_path, scenario, boards):
    site, calibration, cycles, truth = recorded(scenario, boards, tmp_path)
    assert len(cycles) == CYCLES
    assert all(np.isfinite(sums).all() for sums in cycles)

    access = SiteAccess(site)
    separations = [access.from_samples(calibration.field_T(sums)) for sums in cycles]
    fields = np.array([separation.field_T for separation in separations])
    # Shared codes make the errors of beacons alike: the scatter is counted in independent directions.
    inverse = np.linalg.inv(np.linalg.cholesky(access.covariance_T2))
    scatter = np.einsum("ij,ejk->eik", inverse, fields - fields.mean(axis=0))
    freedom = scatter[1:].size
    assert np.sum(scatter**2) / freedom == pytest.approx(1.0, abs=4.0 * np.sqrt(2.0 / freedom))

    ids = tuple(beacon.id for beacon in site.beacons)
    poses = [locate(site, Fields(0, 0.0, ids, one.field_T, one.sigma_T)) for one in separations]
    print(f"{scenario}: scatter {np.sum(scatter**2) / freedom:.2f} of what is expected")
    check_at_the_bound(site, poses, {0: truth}, bound=bound_of_alike(site, truth, access.covariance_T2))
