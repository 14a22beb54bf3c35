"""When messages arrived: in a recording that is told by their stamps, those that were looked at first too."""

import pytest

import goldfield
from tests.host.fake_sensor import CYCLE_S, SITE, log_of

MESSAGES = 11
"""Messages of a cycle: a log has them 0.1 ms apart, from the end of the cycle on."""


@pytest.mark.parametrize("first", [0, 40])
def test_each_epoch_of_a_recording_arrived_when_its_last_message_did(tmp_path, first):
    log = tmp_path / "run.log"
    log.write_text(log_of(range(first, first + 4)))
    with goldfield.open_log(str(log), site=goldfield.load_site(SITE)) as sensor:
        arrived_s = [epoch.arrived_s for epoch in sensor.epochs()]
    expected_s = [(first + 1 + number) * CYCLE_S + (MESSAGES - 1) * 1e-4 for number in range(4)]
    assert arrived_s == pytest.approx(expected_s, abs=2e-6)
