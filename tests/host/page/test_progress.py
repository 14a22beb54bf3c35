"""What the page is told of a survey and of a calibration, and that a browser which comes later gets it too."""

import json

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from goldfield import site as sites
from goldfield.cli.page_progress import ENOUGH_S, SurveyProgress, TurnProgress, upward
from goldfield.page.greeting import hello
from goldfield.page.hub import Hub
from goldfield.page.publishing import Publisher
from goldfield.sensor.opening import open_sensor
from goldfield.types import Fields, Pose, Status
from tests.host.cli.test_survey_live import result_of
from tests.host.fake_sensor import CYCLE_S, SITE, beacon_fields, candump, cycle_messages, heartbeat
from tests.host.page.walk import walk

ROOM = sites.load(SITE)
SIDES = TurnProgress.SIDES


class Page:
    """A hub with a publisher, and what a browser got that has looked from the beginning."""

    def __init__(self):
        self.hub = Hub(hello(ROOM, "a link", live=True), ROOM.cycle_s, live=True)
        self._box = self.hub.open()
        self.publisher = Publisher(self.hub, ROOM, "a link")

    def of(self, kind):
        return [one for one in map(json.loads, self._box.take()) if one["type"] == kind]

    def state(self):
        return json.loads(self.hub.state_message())["state"]


def turned(attitudes, cycles_each):
    """Return a recording of a sensor in one place that is turned from one attitude to the next."""
    lines = [(0.0, heartbeat())]
    for cycle in range(len(attitudes) * cycles_each):
        fields = beacon_fields(attitude=attitudes[cycle // cycles_each])
        end_s = (cycle + 1) * CYCLE_S
        lines += [(end_s + 1e-4 * i, one) for i, one in enumerate(cycle_messages(cycle, fields=fields))]
    return candump(lines)


def pose(rotation):
    return Pose(0, 0.0, np.zeros(3), rotation.as_quat(), np.eye(3), np.eye(3), 1.0, Status.OK, (), ())


@pytest.mark.parametrize(("side", "up"), list(enumerate(np.kron(np.eye(3), [[1.0], [-1.0]]))))
def test_the_side_that_is_up_is_that_whose_axis_points_along_the_site_s_z(side, up):
    rotation, _ = Rotation.align_vectors([[0.0, 0.0, 1.0]], [up])
    assert upward(pose(rotation)) == side
    for degrees, expected in ((39.0, side), (41.0, None)):
        tilted = Rotation.from_rotvec([np.deg2rad(degrees), 0.0, 0.0]) * rotation
        assert upward(pose(tilted)) == expected


def test_an_unknown_attitude_has_no_side_up():
    assert upward(Pose.failed(Fields(0, 0.0, (), np.zeros((0, 3)), np.zeros(0)))) is None


def test_the_page_of_a_calibration_counts_the_time_of_each_side(tmp_path):
    log = tmp_path / "turn.log"
    log.write_text(turned([Rotation.identity(), Rotation.from_euler("x", 180, degrees=True)], 20))
    page = Page()
    progress = TurnProgress(page.publisher, CYCLE_S, 8.0)
    with open_sensor("log", str(log), ROOM, recorder=page.publisher.recorder()) as sensor:
        reports = list(progress.reports(sensor))
    told = page.of("progress")
    assert [report.cycle for report in reports] == list(range(40))
    assert told[0]["share"] == 0.0
    assert told[-1]["task"] == "calibration"
    assert told[-1]["share"] == pytest.approx(0.5, abs=0.5 / 8.0)
    rows = {row["name"]: row["share"] for row in told[-1]["rows"]}
    assert list(rows) == list(SIDES)
    assert rows["z up"] == pytest.approx(2.0 / ENOUGH_S, abs=0.01)
    assert rows["z down"] == pytest.approx(2.0 / ENOUGH_S, abs=0.2)
    assert rows["x up"] == rows["y down"] == 0.0
    assert "x up, x down" in told[-1]["text"]


def test_the_page_of_a_survey_gets_each_epoch_each_look_and_what_is_computed(tmp_path, capsys):
    log = tmp_path / "walk.log"
    log.write_text(walk(12, faults=False))
    page = Page()
    progress = SurveyProgress(page.publisher, 0.002)
    with (
        open_sensor("log", str(log), ROOM) as plain,
        open_sensor("log", str(log), ROOM, recorder=progress.recorder) as sensor,
    ):
        expected = list(plain.fields())
        got = list(progress.fields(sensor))
    assert [one.epoch for one in got] == [one.epoch for one in expected]
    for one, other in zip(got, expected, strict=True):
        np.testing.assert_array_equal(one.field_T, other.field_T)
    assert page.state() == "running"
    progress.say("epoch 99: the beacons are known to 4 mm by 100 epochs", result_of(0.004))
    assert "known to 4 mm" in capsys.readouterr().err
    progress.compute("metal", 0.25)
    assert page.state() == "busy"  # and nobody is sent to look at the sensor's cable
    late = [json.loads(message) for message in page.hub.open().take()]
    last = [one for one in late if one["type"] == "progress"]
    assert len(last) == 1
    assert last[0]["share"] == 0.25
    assert last[0]["text"] == "Epoch 99: the beacons are known to 4 mm by 100 epochs. Now: metal."
    assert len(last[0]["rows"]) == 8
    assert all(row["share"] is None or 0.0 < row["share"] <= 1.0 for row in last[0]["rows"])
