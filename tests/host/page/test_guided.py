"""Whole runs of ``goldfield survey --view`` and ``calibrate sensor --view``, seen in a browser: progress and end."""

import json
import signal
import socket
import subprocess
import sys
import tomllib
from contextlib import contextmanager

import numpy as np
import pytest
from playwright.sync_api import expect
from scipy.spatial.transform import Rotation

from tests.host.fake_sensor import CYCLE_S, SITE, PtySensor, beacon_fields
from tests.host.page.browser import PHONE, chromium
from tests.host.page.walk import attitude, place

TIMEOUT_S = 180.0
MOVED_M = 0.03
"""So far off is a beacon in the site file that the survey begins with."""


def walking(cycle):
    """Return the fields of a cycle of a walk through the room."""
    middle_s = (cycle + 0.5) * CYCLE_S
    return beacon_fields(place(middle_s), attitude(middle_s))


def turning(cycle):
    """Return the fields of a cycle of a sensor that is turned slowly to all sides, in one place."""
    middle_s = (cycle + 0.5) * CYCLE_S
    return beacon_fields(attitude=Rotation.from_euler("zyx", [0.31 * middle_s, 0.17 * middle_s, 0.73 * middle_s]))


@pytest.fixture(scope="module")
def browser():
    with chromium() as started:
        yield started


class Run:
    """A running command with a live page, and that page in a browser on a phone, opened before the sensor speaks."""

    def __init__(self, browser, words, sensor):
        command = [sys.executable, "-m", "goldfield", *words, "--port", sensor.path, "--view", "127.0.0.1:0"]
        self._process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
        told = self._process.stderr.readline()
        assert "the live page is at http://" in told, told
        self._context = browser.new_context(viewport=PHONE)
        self.page = self._context.new_page()
        self.page.set_default_timeout(1000.0 * TIMEOUT_S)
        expect.set_options(timeout=1000.0 * TIMEOUT_S)
        self.page.goto(told.split()[-1])
        expect(self.page.locator("#link-word")).to_have_text("waiting for the sensor")

    def see(self, element, text):
        expect(self.page.locator(element)).to_contain_text(text)

    def interrupt(self):
        self._process.send_signal(signal.SIGINT)

    def ended(self):
        """Wait for the end; return exit code, stdout and stderr."""
        out, err = self._process.communicate(timeout=TIMEOUT_S)
        return self._process.returncode, out, err

    def close(self):
        self._process.kill()
        self._process.communicate()
        self._context.close()


@contextmanager
def run(browser, words, sensor):
    """Start a command that reads a sensor; the sensor begins to speak when the page is seen."""
    running = Run(browser, words, sensor)
    try:
        with sensor:
            yield running
    finally:
        running.close()


@pytest.fixture
def moved_site(tmp_path):
    """Return a site file whose places are not exact and in which the first beacon is off, and the true places."""
    text = SITE.read_text().replace("position_sd_m = 0.0", "position_sd_m = 0.02")
    true = [beacon["position_m"] for beacon in tomllib.loads(text)["beacon"]]
    path = tmp_path / "site.toml"
    old = f"position_m = {json.dumps(true[0])}"
    assert text.count(old) == 1
    path.write_text(text.replace(old, f"position_m = {json.dumps([true[0][0] + MOVED_M, *true[0][1:]])}"))
    return path, true


def check_new_site(path, true):
    """Check that a survey has found where the beacon is that was off: as well as the others tell where the room is."""
    found = [beacon["position_m"] for beacon in tomllib.loads(path.read_text())["beacon"]]
    off_m = np.linalg.norm(np.subtract(found, true), axis=1)
    assert off_m[0] < 0.5 * MOVED_M
    assert off_m.max() < 0.5 * MOVED_M


def test_a_survey_is_walked_to_its_end_with_the_page_in_the_hand(browser, moved_site, tmp_path):
    site, true = moved_site
    out = tmp_path / "new.toml"
    sensor = PtySensor(range(2000), fields_of=walking)
    with run(browser, ["survey", "--site", str(site), "--out", str(out), "--enough", "0.02"], sensor) as survey:
        survey.see("#progress-title", "Survey")
        survey.see("#progress-text", "Done: the beacons are known to")
        survey.see("#progress-text", "new.toml is written.")
        expect(survey.page.locator("#progress-rows li")).to_have_count(8)
        expect(survey.page.locator("#link-word")).to_have_text("ended")
        survey.see("#link-text", "Goldfield has ended.")
        code, table, told = survey.ended()
        expect(survey.page.locator("#link-word")).to_have_text("ended")  # and not cut off: nobody has to look after it
    assert code == 0, told
    assert "the beacons are known to" in told
    assert "that is enough: 20 mm were asked for" in told
    assert len(table.splitlines()) > 8
    check_new_site(out, true)


def test_ctrl_c_ends_the_walk_and_not_the_survey(browser, moved_site, tmp_path):
    site, true = moved_site
    out = tmp_path / "new.toml"
    sensor = PtySensor(range(100_000), fields_of=walking)
    with run(browser, ["survey", "--site", str(site), "--out", str(out), "--enough", "1e-6"], sensor) as survey:
        expect(survey.page.locator("#progress-rows li")).to_have_count(8)  # with the first look
        expect(survey.page.locator("#link-word")).to_have_text("live")
        survey.interrupt()
        survey.see("#progress-text", "Done: the beacons are known to")
        code, _, told = survey.ended()
    assert code == 0, told
    assert "the walk ends with" in told
    check_new_site(out, true)


def test_a_sensor_that_goes_during_the_walk_is_told_on_the_page_too(browser, tmp_path):
    out = tmp_path / "new.toml"
    sensor = PtySensor(range(30), fields_of=walking, hang_up=True)
    with run(browser, ["survey", "--site", str(SITE), "--out", str(out), "--free", "position"], sensor) as survey:
        expect(survey.page.locator("#link-word")).to_have_text("ended")
        survey.see("#link-text", "the port is gone")
        code, _, told = survey.ended()
    assert code == 3
    assert "the port is gone" in told
    assert not out.exists()


def test_a_calibration_is_shown_to_its_end(browser, tmp_path):
    out = tmp_path / "new.toml"
    sensor = PtySensor(range(100_000), fields_of=turning)
    words = ["calibrate", "sensor", "--site", str(SITE), "--out", str(out), "--seconds", "40", "--json"]
    with run(browser, words, sensor) as calibration:
        calibration.see("#progress-title", "Calibration of the sensor")
        calibration.see("#progress-text", "Done: the gains are known to")
        rows = calibration.page.locator("#progress-rows li")
        expect(rows).to_have_count(6)
        shown_s = [float(text.split()[-2]) for text in rows.locator("span").all_inner_texts()]
        expect(calibration.page.locator("#link-word")).to_have_text("ended")
        code, found, told = calibration.ended()
    assert code == 0, told
    assert min(shown_s) > 1.0
    assert sum(shown_s) < 40.5
    found = json.loads(found)
    assert found["status"] == "ok"
    np.testing.assert_allclose(found["axes"], np.eye(3), atol=0.01)
    assert "axes" in tomllib.loads(out.read_text())["sensor"]


def test_ctrl_c_ends_a_calibration_and_nothing_is_written(browser, tmp_path):
    out = tmp_path / "new.toml"
    sensor = PtySensor(range(100_000), fields_of=turning)
    words = ["calibrate", "sensor", "--site", str(SITE), "--out", str(out), "--seconds", "100000"]
    with run(browser, words, sensor) as calibration:
        calibration.see("#progress-text", "still to come")
        expect(calibration.page.locator("#link-word")).to_have_text("live")
        calibration.interrupt()
        expect(calibration.page.locator("#link-word")).to_have_text("ended")
        code, out_text, told = calibration.ended()
    assert (code, out_text) == (130, ""), told
    assert not out.exists()


@pytest.mark.parametrize("command", [["survey", "--free", "position"], ["calibrate", "sensor"], ["run"]])
def test_an_address_that_is_taken_is_refused_by_the_name_of_its_option_before_the_sensor_is_read(command, tmp_path):
    out = tmp_path / "new.toml"
    words = [] if command == ["run"] else ["--out", str(out)]
    with socket.socket() as taken, PtySensor(range(10)) as sensor:
        taken.bind(("127.0.0.1", 0))
        taken.listen()
        where = f"127.0.0.1:{taken.getsockname()[1]}"
        words += ["--site", str(SITE), "--port", sensor.path, "--view", where]
        done = subprocess.run(
            [sys.executable, "-m", "goldfield", *command, *words], capture_output=True, text=True, timeout=TIMEOUT_S
        )
    assert done.returncode == 2
    assert done.stdout == ""
    assert f"--view {where}: this machine cannot listen there" in done.stderr
    assert sensor.requests == []
    assert not out.exists()
