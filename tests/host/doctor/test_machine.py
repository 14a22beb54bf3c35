"""The doctor before any board is heard: installation, permission, port, and a line at another rate."""

from __future__ import annotations

import os
import stat
from itertools import islice

import pytest

from goldfield import site as sites
from goldfield.doctor import machine
from goldfield.doctor.checks import Fault, State
from goldfield.doctor.examination import Examination
from goldfield.link.line import RATES, Line, Link
from goldfield.nodes import conversation as conversations
from tests.host.fake_sensor import NODE, SITE
from tests.host.uart import Uart


def fault_of(path, kind="port", bit_rate=None):
    checks = list(Examination(kind, path, sites.load(SITE), bit_rate=bit_rate).checks())
    (check,) = (check for check in checks if check.fault is not None)
    assert check.advice
    return check


@pytest.fixture
def impatient(monkeypatch):
    monkeypatch.setattr("goldfield.doctor.examination.LISTEN_S", 0.5)
    monkeypatch.setattr(machine, "RATE_S", 2.0)
    monkeypatch.setattr(conversations.Conversation.listen, "__defaults__", (0.5, 0.5))


@pytest.mark.parametrize("baud", RATES[Link.SERIAL])
def test_a_board_at_any_of_its_rates_is_found_and_is_no_fault(baud, monkeypatch):
    with Uart(baud) as board:
        checks = list(islice(Examination("port", board.path, sites.load(SITE)).checks(), 2))
    assert [check.state for check in checks] == [State.SOUND] * 2
    assert checks[1].text == f"node {NODE} at {board.path}, {Line(Link.SERIAL, baud)}"


@pytest.mark.parametrize("baud", [115_200, 1_000_000])
def test_a_wrong_baud_rate_is_named(baud, impatient, monkeypatch):
    """That of an adapter, or that of a board for which another one was given."""
    monkeypatch.setattr(machine, "BYTES_S", 10.0)
    ours = baud in RATES[Link.SERIAL]
    with Uart(baud) as board:
        check = fault_of(board.path, bit_rate=2_000_000 if ours else None)
    assert check.fault is Fault.BAUD
    assert f"are right at {baud} baud" in check.text
    assert (f"--bit-rate {baud}" in check.advice) is ours
    assert ("2000000, 921600, 460800 or 115200 baud" in check.text) is not ours


def test_a_line_that_is_right_at_no_rate_is_no_sensors(impatient, monkeypatch):
    monkeypatch.setattr(machine, "RATE_S", 0.05)
    monkeypatch.setattr(machine, "BYTES_S", 10.0)
    with Uart(3_000_000) as board:
        check = fault_of(board.path)
    assert check.fault is Fault.BAUD
    assert "right at any rate" in check.text


@pytest.mark.parametrize("where", ["socketcan:can7", "slcan:/dev/ttyACM0"])
def test_a_bus_at_another_rate_shows_errors_only(where):
    """No frame tells the rate: the rates that there are, and how to set one, are told."""
    line = Line(Link.CAN, 500_000)
    silent, corrupt = (machine.silence("can", where, line, bad) for bad in (0, 1))
    assert "no board is heard" in silent.text
    assert corrupt.text == "1 frame or bit was corrupt and no frame was right on CAN at 500 kbit/s"
    for check in (silent, corrupt):
        assert "1000000, 500000, 250000 or 125000 bit/s" in check.advice
        assert ("ip link set can7 up type can bitrate" in check.advice) is where.startswith("socketcan")
        assert ("--bit-rate" in check.advice) is where.startswith("slcan")


def test_a_silent_port(impatient):
    master, slave = os.openpty()
    check = fault_of(os.ttyname(slave))
    assert (check.fault, "no board is heard" in check.text) == (Fault.LINK, True)
    assert "TX and RX" in check.advice
    os.close(master)
    os.close(slave)


@pytest.mark.skipif(os.geteuid() != 0, reason="only root can become another user")
def test_no_permission():
    master, slave = os.openpty()
    path = os.ttyname(slave)
    os.chmod(path, stat.S_IRUSR | stat.S_IWUSR | stat.S_IRGRP | stat.S_IWGRP)  # noqa: PTH101
    groups = os.getgroups()
    os.setgroups([])
    os.setegid(65534)
    os.seteuid(65534)
    try:
        check = machine.permission("port", path)
    finally:
        os.seteuid(0)
        os.setegid(0)
        os.setgroups(groups)
    assert check is not None
    assert check.fault is Fault.PERMISSION
    assert check.advice.startswith("sudo usermod -aG ")
    assert machine.permission("port", path) is None
    os.close(master)
    os.close(slave)


def test_without_permission_nothing_is_opened(monkeypatch):
    monkeypatch.setattr(machine, "permission_problem", lambda path: f"you may not open {path}: sudo usermod")
    monkeypatch.setattr(machine, "open_link", lambda *_: pytest.fail("the port was opened"))
    check = fault_of("/dev/ttyUSB0")
    assert (check.fault, check.text, check.advice) == (
        Fault.PERMISSION,
        "you may not open /dev/ttyUSB0",
        "sudo usermod",
    )


def test_a_port_that_is_not_there():
    check = fault_of("/dev/nowhere")
    assert (check.fault, check.text) == (Fault.LINK, "/dev/nowhere: there is no such port")
    assert "goldfield ports" in check.advice


@pytest.mark.parametrize("where", ["nonsense", "nosuch:can0"])
def test_a_bus_that_is_none(where):
    assert fault_of(where, "can").fault is Fault.LINK


def test_a_part_that_is_missing(monkeypatch):
    (check,) = machine.installation()
    assert check.state is State.SOUND
    monkeypatch.setattr(machine, "PARTS", ("goldfield.nowhere",))
    (check,) = machine.installation()
    assert (check.fault, "goldfield.nowhere cannot be loaded" in check.text) == (Fault.INSTALLATION, True)
