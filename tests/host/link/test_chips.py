"""Raw chips: put together to cycles, calibrated, and printed by the command, from a sensor on a pseudo-terminal."""

import numpy as np
import pytest

from goldfield.cli import main
from goldfield.link.chips import Calibration, ChipAssembler
from goldfield_protocol import encode
from goldfield_protocol.messages import decode
from tests.host.fake_sensor import CHIPS, EARTH_T, NODE, SITE, PtySensor, beacon_fields, heartbeat

SET = "PARAM_SET"
ZERO = np.array([2050.0, 2040.0, 2048.5])
MATRIX = np.array([[1.0e-7, 1e-9, 0.0], [0.0, 0.98e-7, 2e-9], [0.0, 0.0, 1.03e-7]])


def sums_of(field_T):
    """Burst sums, whole numbers, that a sensor of this calibration makes of fields."""
    counts = field_T @ np.linalg.inv(MATRIX).T + ZERO
    return np.round(8.0 * (counts - 2048.0))


def chip_messages(cycle, sums):
    return [
        encode("CHIP", {"x": x, "y": y, "z": z, "cycle_low": cycle % 65536}, node=NODE, index=chip)
        for chip, (x, y, z) in enumerate(sums)
    ]


def feed(assembler, messages):
    return [sums.copy() for identifier, data in messages for sums in assembler.feed(decode(identifier, data))]


def test_cycles_are_put_together():
    rng = np.random.default_rng(1)
    cycles = rng.integers(-16376, 16376, size=(4, 31, 3)).astype(float)
    messages = [message for number, sums in enumerate(cycles) for message in chip_messages(65534 + number, sums)]
    lost = [10, 31 + 5, 62]  # of the first cycle, of the second, and chip 0 of the third
    heard = [message for place, message in enumerate(messages) if place not in lost]
    first, second = feed(ChipAssembler(31), heard)
    for cycle, got, missing in ((0, first, 10), (1, second, 5)):
        assert np.isnan(got[missing]).all()
        np.testing.assert_array_equal(np.delete(got, missing, axis=0), np.delete(cycles[cycle], missing, axis=0))


def test_the_first_cycle_counts_from_its_begin_only():
    sums = np.ones((31, 3))
    assert feed(ChipAssembler(31), chip_messages(5, sums)[3:] + chip_messages(6, sums)) == []
    assert len(feed(ChipAssembler(31), [*chip_messages(6, sums), *chip_messages(7, sums)])) == 1


def test_saturated_axes_and_strange_chips():
    sums = np.ones((31, 3))
    sums[4, 1] = -32768
    beyond = encode("CHIP", {"x": 1, "y": 1, "z": 1, "cycle_low": 9}, node=NODE, index=31)
    (got,) = feed(ChipAssembler(31), [*chip_messages(6, sums), beyond, *chip_messages(7, sums)])
    assert np.argwhere(np.isnan(got)).tolist() == [[4, 1]]
    field = Calibration(ZERO, MATRIX).field_T(got)
    assert np.argwhere(np.isnan(field)).tolist() == [[4, 0], [4, 1]]  # x needs y, z does not


def test_calibration_is_the_inverse_of_the_sensor():
    fields = np.random.default_rng(2).uniform(-1e-4, 1e-4, size=(31, 3))
    np.testing.assert_allclose(Calibration(ZERO, MATRIX).field_T(sums_of(fields)), fields, atol=0.6 * 1.1e-7 / 8)


class Streaming(PtySensor):
    """A sensor that streams chips while parameter 4 is 1."""

    def __init__(self):
        values = {4: 0, **{8 + i: float(v) for i, v in enumerate(ZERO)}}
        values |= {16 + i: float(v) for i, v in enumerate(MATRIX.ravel())}
        super().__init__([], parameters=values)
        self.sums = sums_of(CHIPS @ beacon_fields() + EARTH_T)

    def _configured(self):
        return False

    def _answer(self, frame):
        message = decode(frame.identifier, frame.data)
        self.requests.append(message.name)
        number = message.index
        if message.name == "PARAM_SET":
            self.parameters[number] = int(message.signals["value_unsigned"])
        value = self.parameters[number]
        signals = {"kind": 2, "status": 0, "value_float": value}
        if isinstance(value, int):
            signals = {"kind": 0, "status": 0, "value_unsigned": value}
        self._send(encode("PARAM_VALUE", signals, node=NODE, index=number))
        if message.name == "PARAM_SET" and value:
            for cycle in range(3):
                for chip in chip_messages(cycle, self.sums):
                    self._send(chip)


def test_the_command_prints_what_separate_reads(tmp_path, capsys):
    with Streaming() as sensor:
        assert main(["samples", "--port", sensor.path, "--site", str(SITE), "--cycles", "2"]) == 0
        assert sensor.parameters[4] == 0
    table, fields = tmp_path / "samples.csv", tmp_path / "fields.csv"
    table.write_text(capsys.readouterr().out)
    assert main(["separate", "--site", str(SITE), str(table), "--fields", str(fields), "--json"]) == 0
    assert len(capsys.readouterr().out.splitlines()) == 2
    assert main(["locate", "--site", str(SITE), str(fields), "--json"]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert len(lines) == 2
    assert '"status": "ok"' in lines[0]


def test_a_sensor_that_is_only_listened_to_is_asked_nothing(capsys):
    """Its stream is on already; its calibration is not known."""

    class Stored(Streaming):
        def _serve(self):
            for cycle in range(3):
                for message in (heartbeat(), *chip_messages(cycle, self.sums)):
                    self._send(message)
            super()._serve()

    with Stored() as sensor:
        assert main(["samples", "--port", sensor.path, "--site", str(SITE), "--listen-only"]) == 0
        assert sensor.requests == []
        sums = sensor.sums
    out, err = capsys.readouterr()
    rows = np.genfromtxt(out.splitlines(), delimiter=",", skip_header=1)
    np.testing.assert_allclose(rows[:, 1:], sums / 8.0 * 400e-6 / 4096, atol=1e-15)
    assert err.endswith("its calibration is unknown: that of the parameters' defaults is taken\n")


def test_the_stream_is_switched_on_again_after_a_restart(capsys):
    """A sensor that starts has forgotten it: without power for a moment, or behind a port that was gone."""

    class Restarting(Streaming):
        def _answer(self, frame):
            message = decode(frame.identifier, frame.data)
            super()._answer(frame)
            if message.name == "PARAM_SET" and message.signals["value_unsigned"] and self.requests.count(SET) == 1:
                self.parameters[4] = 0
                self._send(heartbeat(state=0))

    with Restarting() as sensor:
        assert main(["samples", "--port", sensor.path, "--site", str(SITE), "--cycles", "4"]) == 0
        assert sensor.requests[-4:] == ["PARAM_GET", SET, SET, SET]
    assert len(capsys.readouterr().out.splitlines()) == 1 + 4 * 1023


def test_a_silent_sensor_is_waited_for(capsys, monkeypatch):
    monkeypatch.setattr("goldfield.sensor.samples.SILENCE_S", 0.2)

    class Late(Streaming):
        """The first time that it is switched on it sends nothing."""

        def _answer(self, frame):
            sums = self.sums
            if decode(frame.identifier, frame.data).name == SET and SET not in self.requests:
                self.sums = sums[:0]
            super()._answer(frame)
            self.sums = sums

    with Late() as sensor:
        assert main(["samples", "--port", sensor.path, "--site", str(SITE), "--reconnect"]) == 0
    out, err = capsys.readouterr()
    assert len(out.splitlines()) == 1 + 1023
    assert "sent no raw chip for 0 s; waiting for it" in err


def test_the_place_of_a_survey_is_in_every_row(capsys):
    with Streaming() as sensor:
        assert main(["samples", "--port", sensor.path, "--site", str(SITE), "--at", "1", "-2.5", ".5"]) == 0
    header, *rows = capsys.readouterr().out.splitlines()
    assert header == "chip,bx_T,by_T,bz_T,x_m,y_m,z_m"
    assert len(rows) == 1023
    assert all(row.endswith(",1.0,-2.5,0.5") for row in rows)


def test_a_sensor_that_does_not_stream_is_a_failure(capsys, monkeypatch):
    monkeypatch.setattr("goldfield.sensor.samples.SILENCE_S", 0.2)

    class Silent(Streaming):
        def _answer(self, frame):
            self.sums = self.sums[:0]
            super()._answer(frame)

    with Silent() as sensor:
        assert main(["samples", "--port", sensor.path, "--site", str(SITE)]) == 3
    assert "sent no raw chip" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("options", "words"), [(["--site", str(SITE)], "--port is missing"), ([], "--site is missing")]
)
def test_what_is_missing_is_said(capsys, options, words):
    assert main(["samples", *options]) == 2
    assert words in capsys.readouterr().err
