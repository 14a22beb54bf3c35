"""The health of a sensor: figures against fields that magpylib made, losses, and a table that stays in place."""

import json
import os

import jsonschema
import pytest

from goldfield.cli import main
from goldfield.cli.monitor import Screen
from goldfield_protocol import encode
from hil_sim.clib import ROOT
from tests.host.fake_sensor import CYCLE_S, NODE, SITE, beacon_fields, candump, cycle_messages, heartbeat

CYCLES = 20


@pytest.fixture
def monitored(tmp_path, capsys):
    """Return a function that monitors a recording of messages: a list of those of each cycle."""

    def run(cycles, *words):
        lines = [(0.0, heartbeat())]
        lines += [
            ((number + 1) * CYCLE_S + i * 1e-4, m) for number, own in enumerate(cycles) for i, m in enumerate(own)
        ]
        log = tmp_path / "run.log"
        log.write_text(candump(lines))
        assert main(["monitor", "--log", str(log), "--site", str(SITE), *words]) == 0
        return capsys.readouterr().out

    return run


def test_a_beacon_of_less_field_and_one_that_is_reversed(monitored):
    fields = beacon_fields()
    fields[2] *= 0.8
    fields[4] *= -1.0
    out = monitored([cycle_messages(number, fields=fields) for number in range(CYCLES)], "--json", "--every", "2")
    (line,) = map(json.loads, out.splitlines())
    jsonschema.validate(line, json.loads((ROOT / "docs/schema/health.schema.json").read_text()))
    assert line["cycles_per_s"] == pytest.approx(1.0 / CYCLE_S, rel=1e-6)
    assert (line["lost"], line["locked"], line["node"]) == (0, True, NODE)
    ratios = {name: one["ratio"] for name, one in line["beacons"].items()}
    names = list(ratios)
    assert ratios[names[2]] == pytest.approx(0.8, abs=0.03)
    assert ratios[names[4]] == pytest.approx(-1.0, abs=0.05)
    for name in (*names[:2], names[3], *names[5:]):
        assert ratios[name] == pytest.approx(1.0, abs=0.05)
    assert not line["beacons"][names[4]]["used"]


def test_lost_messages_and_chips_are_counted_in_the_window_and_in_all(monitored):
    cycles = [cycle_messages(number) for number in range(2 * CYCLES)]
    del cycles[3][5]
    status = {"chips": 1000, "saturated": 7, "fields": 8, "locked": 0, "phase": 0, "temperature": 25}
    cycles[-1][1] = encode("EPOCH_STATUS", status | {"cycle_low": (2 * CYCLES - 1) % 16}, node=NODE)
    first, last = map(json.loads, monitored(cycles, "--json", "--every", "2").splitlines())
    assert (first["lost"], first["lost_in_all"], first["lost_chips"], first["locked"]) == (1, 1, 0, True)
    assert (last["lost"], last["lost_in_all"], last["lost_chips"], last["saturated"]) == (0, 1, 23, 7)
    assert last["locked"] is False


def test_without_a_terminal_each_look_is_one_line(monitored):
    out = monitored([cycle_messages(number) for number in range(25)])
    assert len(out.splitlines()) == 3  # each second, and what is left at the end
    assert "10.0 cycles/s, 0 lost, locked, 10 ok" in out
    assert "\x1b" not in out


def test_on_a_terminal_the_table_is_drawn_in_place_and_fits_it(monitored, monkeypatch):
    monkeypatch.setattr("sys.stdout.isatty", lambda: True)
    monkeypatch.setattr("shutil.get_terminal_size", lambda *_, **__: os.terminal_size((80, 24)))
    first, second = monitored([cycle_messages(number) for number in range(CYCLES)]).split("\x1b[")[:2]
    assert second == f"{len(first.splitlines())}A"
    assert all(len(line) <= 80 for line in first.splitlines())
    assert sum(line.endswith("used") for line in first.splitlines()) == 8


def test_what_does_not_fit_the_terminal_is_cut(monkeypatch, capsys):
    monkeypatch.setattr("shutil.get_terminal_size", lambda *_, **__: os.terminal_size((10, 4)))
    Screen(lambda: "\n".join(["x" * 20] * 9))()
    assert capsys.readouterr().out == "\n".join(["x" * 10] * 3) + "\n"
