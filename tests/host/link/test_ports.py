"""The ports of a machine: what they seem to be, who may open them, and libraries that misbehave."""

import json
import os
import stat
import subprocess
from types import SimpleNamespace

import can
import jsonschema
import pytest
from serial.tools import list_ports

from goldfield.cli import main
from goldfield.link import can_detection, ports
from hil_sim.clib import ROOT


class Port(SimpleNamespace):
    def __lt__(self, other):
        return self.device < other.device


def port(device, vid=None, pid=None, description="n/a", manufacturer=None, serial_number=None):
    about = {"vid": vid, "pid": pid, "description": description, "manufacturer": manufacturer}
    return Port(device=device, serial_number=serial_number, **about)


def can_of_kernel(network, name, operstate, flags):
    path = network / name
    path.mkdir(parents=True)
    for file, text in (("type", "280"), ("operstate", operstate), ("flags", flags)):
        (path / file).write_text(text + "\n")


def test_each_port_says_what_it_seems_to_be(monkeypatch):
    found = [
        port("/dev/ttyUSB1", 0x0403, 0x6001, "FT232R USB UART", "FTDI", "A50285BI"),
        port("/dev/ttyACM0", 0x0483, 0x374B, "ST-Link"),
        port("/dev/ttyUSB0", 0x4242, 0x0001, "Thing"),
        port("/dev/ttyS0"),
    ]
    monkeypatch.setattr(list_ports, "comports", lambda: found)
    by_path = {one.path: one for one in ports.serial_ports()}
    assert list(by_path) == ["/dev/ttyACM0", "/dev/ttyS0", "/dev/ttyUSB0", "/dev/ttyUSB1"]
    assert by_path["/dev/ttyUSB1"].seems == "USB serial adapter (FTDI)"
    assert by_path["/dev/ttyUSB1"].usb == "0403:6001"
    assert by_path["/dev/ttyACM0"].seems.startswith("ST-LINK probe")
    assert by_path["/dev/ttyUSB0"].seems == "USB device of an unknown kind"
    assert (by_path["/dev/ttyS0"].usb, by_path["/dev/ttyS0"].description) == (None, None)


@pytest.mark.skipif(os.geteuid() != 0, reason="only root can become another user")
@pytest.mark.parametrize(
    ("mode", "text"),
    [
        (0o666, None),
        (0o660, "which the group root may: sudo usermod -aG root "),
        (0o600, "belongs to root: sudo chmod"),
    ],
)
def test_a_port_that_the_user_may_not_open(mode, text, tmp_path):
    for folder in (tmp_path, *tmp_path.parents[:3]):
        folder.chmod(folder.stat().st_mode | stat.S_IXOTH)
    path = tmp_path / "port"
    path.touch()
    path.chmod(mode)
    groups = os.getgroups()
    os.setgroups([])
    os.setegid(65534)
    os.seteuid(65534)
    try:
        problem = ports.permission_problem(str(path))
    finally:
        os.seteuid(0)
        os.setegid(0)
        os.setgroups(groups)
    assert (problem is None) if text is None else (text in problem)


def test_a_port_that_is_not_there_is_no_question_of_permission(tmp_path):
    assert ports.permission_problem(str(tmp_path / "nothing")) is None


def test_the_kernels_can_interfaces(monkeypatch, tmp_path):
    can_of_kernel(tmp_path, "can0", "down", "0x40080")
    can_of_kernel(tmp_path, "can1", "up", "0x40081")
    can_of_kernel(tmp_path, "vcan0", "unknown", "0xc1")
    (tmp_path / "lo").mkdir()
    (tmp_path / "lo/type").write_text("772\n")
    monkeypatch.setattr(
        ports.subprocess, "run", lambda *_, **__: SimpleNamespace(returncode=0, stdout='[["pcan","1"]]')
    )
    down, *others = ports.can_interfaces(network=tmp_path)
    assert down.problem == "can0 is down: sudo ip link set can0 up type can bitrate 1000000"
    usable = [(one.interface, one.channel, one.problem) for one in others]
    assert usable == [("socketcan", "can1", None), ("socketcan", "vcan0", None), ("pcan", "1", None)]


@pytest.mark.parametrize("ended", ["hung", "crashed"])
def test_a_vendors_library_that_hangs_or_crashes_costs_its_own_devices_only(ended, monkeypatch, tmp_path):
    can_of_kernel(tmp_path, "can0", "up", "0x40081")

    def run(command, **_):
        if ended == "hung":
            raise subprocess.TimeoutExpired(command, 1.0)
        return SimpleNamespace(returncode=-11, stdout="half a li")

    monkeypatch.setattr(ports.subprocess, "run", run)
    assert [one.channel for one in ports.can_interfaces(network=tmp_path)] == ["can0"]


def test_a_library_that_raises_leaves_the_others(monkeypatch):
    def configurations(interface, timeout):
        if interface == "pcan":
            raise OSError("driver")
        return [{"interface": interface, "channel": 1}] if interface == "kvaser" else []

    monkeypatch.setattr(can, "detect_available_configs", configurations)
    assert can_detection.detected(0.1, ("socketcan",)) == [("kvaser", "1")]


def test_the_command_prints_the_line_to_paste(monkeypatch, capsys):
    monkeypatch.setattr(list_ports, "comports", lambda: [port("/dev/ttyUSB0", 0x10C4, 0xEA60, "CP2102N")])
    monkeypatch.setattr(ports, "can_interfaces", lambda: [ports.CanInterface("socketcan", "can0", None)])
    assert main(["ports", "--site", "my room.toml"]) == 0
    out = capsys.readouterr().out
    assert "goldfield run --port /dev/ttyUSB0 --site 'my room.toml'" in out
    assert "goldfield run --can socketcan:can0 --site 'my room.toml'" in out
    assert main(["ports", "--json"]) == 0
    schema = json.loads((ROOT / "docs/schema/port.schema.json").read_text())
    lines = [json.loads(line) for line in capsys.readouterr().out.splitlines()]
    assert [line["kind"] for line in lines] == ["serial", "can"]
    for line in lines:
        jsonschema.validate(line, schema)


def test_nothing_found_says_what_to_do(monkeypatch, capsys):
    monkeypatch.setattr(list_ports, "comports", list)
    monkeypatch.setattr(ports, "can_interfaces", list)
    assert main(["ports"]) == 0
    assert "plug the adapter in" in capsys.readouterr().out
