"""``--bit-rate`` of every command with a link: it reaches the link, and what is none is told in one sentence."""

from __future__ import annotations

import pytest

from goldfield.cli import main
from goldfield.errors import UserError
from goldfield.nodes import opening
from goldfield.sensor import opening as sensors
from tests.host.fake_sensor import SITE

CAN = ["--can", "virtual:bits"]
COMMANDS = {
    "run": ["run", "--site", str(SITE), *CAN],
    "monitor": ["monitor", "--site", str(SITE), *CAN],
    "nodes": ["nodes", *CAN],
    "nodes get": ["nodes", "get", "3", *CAN],
    "nodes bit-rate": ["nodes", "bit-rate", "125000", *CAN],
    "site push": ["site", "push", str(SITE), *CAN],
    "doctor": ["doctor", "--site", str(SITE), *CAN],
    "calibrate": ["calibrate", "sensor", "--site", str(SITE), *CAN],
    "samples": ["samples", "--site", str(SITE), "--port", "/dev/nowhere"],
}
NO_CAN = "boards speak on CAN at 1000000, 500000, 250000 or 125000 bit/s"
NO_SERIAL = "boards speak on serial at 2000000, 921600, 460800 or 115200 baud"


def refused(capsys, *words):
    """What a command says that exits with 2."""
    try:
        code = main(list(words))
    except SystemExit as end:
        code = end.code
    assert code == 2
    return capsys.readouterr().err


@pytest.mark.parametrize("rate", ["0", "-1", "1e9", "123456"])
@pytest.mark.parametrize("command", COMMANDS)
def test_a_rate_that_no_board_has_is_refused_by_all(capsys, command, rate):
    told = refused(capsys, *COMMANDS[command], f"--bit-rate={rate}")
    assert f"--bit-rate {int(float(rate))}: boards speak on" in told
    assert (NO_SERIAL if command == "samples" else NO_CAN) in told


@pytest.mark.parametrize("rate", ["", "fast", "nan", "inf", "1.5", "0x10", "500k"])
def test_what_is_no_number_is_said(capsys, rate):
    assert f"{rate} is no whole number of bits a second" in refused(capsys, *COMMANDS["nodes"], f"--bit-rate={rate}")


def opened_at(monkeypatch, *words):
    def opens(*arguments, bit_rate=None, **_):
        raise UserError(f"opened at {bit_rate}")

    monkeypatch.setattr(opening, "open_can", opens)
    monkeypatch.setattr("goldfield.sensor.sources.open_can", opens)
    return main(list(words))


@pytest.mark.parametrize("command", ["run", "monitor", "nodes", "nodes get", "site push", "calibrate"])
@pytest.mark.parametrize(
    ("given", "variable", "at"), [("5e5", None, 500_000), (None, "250000", 250_000), (None, "", None)]
)
def test_it_reaches_the_link(monkeypatch, capsys, command, given, variable, at):
    if variable is not None:
        monkeypatch.setenv("GOLDFIELD_BIT_RATE", variable)
    words = COMMANDS[command] + ([] if given is None else ["--bit-rate", given])
    assert opened_at(monkeypatch, *words) == 2
    assert capsys.readouterr().err.endswith(f"opened at {at}\n")


def test_an_option_before_the_action_counts(monkeypatch, capsys):
    assert opened_at(monkeypatch, "nodes", "--bit-rate", "125000", *CAN, "get", "3") == 2
    assert capsys.readouterr().err.endswith("opened at 125000\n")


def test_it_has_no_effect_with_a_recording(monkeypatch, capsys, tmp_path):
    log = tmp_path / "none.log"
    main(["run", "--site", str(SITE), "--log", str(log), "--bit-rate", "125000"])
    assert "--bit-rate has no effect with --log" in capsys.readouterr().err


def test_python_has_it_too():
    with pytest.raises(UserError, match=f"bit_rate=123456: {NO_CAN}"):
        sensors.connect(can="virtual:bits", site=SITE, bit_rate=123_456)
