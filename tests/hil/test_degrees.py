"""Codes of other degrees on the whole chain: from the boards' chips to poses at the bound."""

import numpy as np
import pytest

from goldfield.access.epoch import EpochSeparator
from goldfield.access.gold import code_matrix
from goldfield.link.reports import Assembler
from goldfield.locate import locate
from goldfield.sensor.on_sensor import on_sensor_pose
from goldfield_protocol import FrameDecoder, decode
from hil_sim.bench import SimulatedBench
from hil_sim.scenario import SCENARIOS
from tests.hil.bound import check_at_the_bound


def scenario(directory, degree, replacements=()):
    """Write the scenario prigge8 with another degree; the codes from the family's end, u among them."""
    text = (SCENARIOS / "prigge8.toml").read_text().replace("seed = 1\n", f"seed = 1\ndegree = {degree}\n", 1)
    for code, new in zip(range(2, 10), (2**degree - 1, 2**degree - 2, 0, 5, 6, 17, 20, 29), strict=True):
        text = text.replace(f"code = {code}\n", f"code = N{new}\n")
    text = text.replace("code = N", "code = ")
    for old, new in replacements:
        assert old in text
        text = text.replace(old, new)
    path = directory / f"degree{degree}.toml"
    path.write_text(text)
    return str(path)


@pytest.mark.slow  # on emulated boards: `make test-host-boards` runs it too
def test_poses_at_the_bound(tmp_path, rig_kind):
    check_poses(tmp_path, 7, rig_kind, 100)


@pytest.mark.parametrize("degree", [9, 11])
def test_poses_at_the_bound_on_host_boards(tmp_path, degree):
    check_poses(tmp_path, degree, "host", 40)


def check_poses(directory, degree, kind, cycles):
    """Host's and sensor's own poses of every cycle, against the truth and the Cramer-Rao bound of N samples."""
    bench = SimulatedBench(scenario(directory, degree), kind, directory)
    try:
        bench.reports(cycles + 4)
        assembler, separator, found = Assembler(on_sensor=True), EpochSeparator(bench.site), []
        for frame in FrameDecoder().feed(bytes(bench.stream)):
            for report in assembler.feed(decode(frame.identifier, frame.data), 0.0):
                fields = separator.fields(report)
                found.append((report, locate(bench.site, fields), on_sensor_pose(bench.site, report, fields)))
        bench.rig.advance(0.25)  # The truth of a cycle is told from the sync wire's next edge on.
        found, truth = found[-cycles - 1 : -1], bench.truth()
    finally:
        bench.rig.close()
    assert [report.cycle for report, *_ in found] == list(range(found[0][0].cycle, found[0][0].cycle + cycles))
    assert all(report.complete and report.locked and report.chips == 2**degree - 1 for report, *_ in found)
    assert max(code for report, *_ in found for code in report.correlation_T) == 2**degree - 1
    for which in (1, 2):
        print(f"degree {degree}, {kind} boards, poses of the {'host' if which == 1 else 'sensor'}:", end=" ")
        check_at_the_bound(bench.site, [row[which] for row in found], truth, within=0.25)


def test_three_hundred_cycles_a_second_on_serial_and_can(tmp_path):
    """Degree 5: 31 chips, 3.03 ms. Eight beacons' fields of every cycle reach both links, whole and in order."""
    path = scenario(tmp_path, 5, [("pose = 1", "pose = 0")])
    bench = SimulatedBench(path, "host", tmp_path)
    try:
        bench.rig.can_read()
        reports = bench.reports(250)
        on_can, assembler = [], Assembler()
        for frame in bench.rig.can_read():
            message = decode(frame.identifier, frame.data)
            if message is not None and message.node == 100:
                on_can += assembler.feed(message, frame.time_s)
    finally:
        bench.rig.close()
    assert [r.cycle for r in reports] == list(range(reports[0].cycle, reports[0].cycle + 250))
    for received in (reports, on_can[1:]):
        assert len(received) >= 240
        assert all(r.complete and r.locked and r.chips == 31 and len(r.correlation_T) == 8 for r in received)
    assert [r.cycle for r in on_can] == list(range(on_can[0].cycle, on_can[0].cycle + len(on_can)))
    separator = EpochSeparator(bench.site)
    fields = np.array([separator.fields(r).field_T for r in reports])
    expected = 2e-7 * np.sqrt(np.diag(np.linalg.inv(gram(bench.site))))[:8]
    spread = fields.std(axis=0)
    assert spread == pytest.approx(np.repeat(expected[:, None], 3, axis=1), rel=0.2)


def gram(site):
    columns = np.hstack([code_matrix(site.degree, site.codes).astype(float), np.ones((site.chips, 1))])
    return columns.T @ columns
