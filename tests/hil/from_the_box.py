"""A bench of host boards from the box, with numbers that collide, and the command line on its CAN bus."""

from __future__ import annotations

import contextlib
import dataclasses
import io
import json
import re
import shlex

import numpy as np

from goldfield.cli import main
from goldfield.nodes import conversation as conversations
from goldfield.nodes import opening
from goldfield_protocol.parameters import build_page, parse_page
from hil_sim.clib import ROOT
from hil_sim.rig import Rig
from hil_sim.rig.boards import factory
from hil_sim.scenario import load_scenario
from hil_sim.scenario.site_file import site_toml
from tests.firmware.host_rig import PIN_ENABLE
from tests.hil.rig_link import RigLink, RigSerialLink

BOOTED_S = 2.5
CALIBRATION = ("zero_x", "zero_y", "zero_z", "calibration")
"""What a sensor has from where it was made."""
SHARED = (7, 9, 11)
"""The numbers that the boards have from the box: many share each."""
MOST_SITED = 64
"""Beacons that a sensor reports; further ones are spare boards."""
COMMAND = re.compile(r"^ +goldfield (.*)$", re.M)


def from_the_box(spec, edge):
    """A board with a shared number and nothing else; a sensor is calibrated."""
    place = place_of(spec.unique_id)
    page = parse_page(spec.parameter_page)
    own = {name: page[name] for name in CALIBRATION if name in page}
    page = build_page({"node": SHARED[place % len(SHARED)], **(own if place == 0 else {})})
    return factory("host")(dataclasses.replace(spec, parameter_page=page), edge)


def place_of(unique_id):
    """Which board of the rig it is, 0 the sensor: the unique ids of simulated boards tell it."""
    return int.from_bytes(unique_id[8:], "little")


def hall(beacons, spacing_m=1.5, sited=MOST_SITED):
    """The text of a scenario: so many beacons on two levels of a grid, the sensor among them; some of them spare."""
    text = (ROOT / "hil_sim/scenarios/prigge8.toml").read_text()
    text = text[: text.index("[[beacon]]")].replace('name = "prigge8"', 'name = "hall"').replace("pose = 1", "pose = 0")
    side = int(np.ceil(np.sqrt(beacons / 2)))
    for i in range(beacons):
        x, y, z = i // 2 % side * spacing_m, i // 2 // side * spacing_m, i % 2 * 1.78
        text += f'[[beacon]]\nid = "b{i + 1}"\nnode = {i + 1}\nposition_m = [{x}, {y}, {z}]\n'
        # Codes of spare boards are not in the list of the scenario's sensor, which has 64 places.
        text += f"code = {i + 2}\n" if i < sited else f"codes = [{{ code = {i + 2} }}, {{ code = {i + 200} }}]\n"
        text += "sync_master = true\n" if i == 0 else ""
    return text


def documented_commands():
    """The commands of docs/boards.md from the box to a started site, without the option that names the link."""
    text = (ROOT / "docs/boards.md").read_text()
    section = text[text.index("## 4. From the box to a site") : text.index("## 5. Commissioning")]
    return [shlex.split(line.replace("--can socketcan:can0", "")) for line in COMMAND.findall(section)]


@contextlib.contextmanager
def benches(monkeypatch, folder):
    """Yield what makes a `Bench` from the text of a scenario; they, and what they replace in the host, end with it."""
    for module, name in ((opening, "open_link"), (conversations, "time")):
        monkeypatch.setattr(module, name, getattr(module, name))  # the bench puts its own there
    path, made = folder / "scenario.toml", []

    def make(text, sited=None):
        path.write_text(text)
        made.append(Bench(path, sited))
        return made[-1]

    try:
        yield make
    finally:
        for one in made:
            one.rig.close()


class Bench:
    """A rig of boards from the box; ``sited`` of its beacons are in its site, the others are spare."""

    def __init__(self, scenario_path, sited=None):
        self.scenario = load_scenario(str(scenario_path))
        self.sited = self.scenario.beacons[:sited]
        self.rig = Rig(self.scenario, from_the_box)
        self.rig.watch_pins()
        self.rig.advance(BOOTED_S)
        self.link = None

    def run(self, *words, port=None, into=None):
        """Return exit code, stdout and stderr of a command on a link of its own: the bus, or the port of a board.

        stdout is empty if it goes ``into`` a file.
        """
        self.link = RigLink(self.rig) if port is None else RigSerialLink(self.rig, port)
        opening.open_link, conversations.time = lambda *_: self.link, self.link
        out, told = io.StringIO(), io.StringIO()
        link = ["--can", "socketcan:can0"] if port is None else ["--port", f"/dev/ttyUSB{port}"]
        with contextlib.redirect_stdout(into or out), contextlib.redirect_stderr(told):
            code = main([*words, *link])
        return code, out.getvalue(), told.getvalue()

    def lines(self, *words, port=None):
        code, out, told = self.run(*words, "--json", port=port)
        assert code == 0, told
        return [json.loads(line) for line in out.splitlines()]

    def numbers(self, listed):
        """The number of each beacon's board, from the lines of ``nodes boards``."""
        places = {place_of(bytes.fromhex(line["unique_id"])): line["node"] for line in listed}
        return {beacon.id: places[i + 1] for i, beacon in enumerate(self.sited)}

    def write_site(self, path, listed):
        """Write the scenario's site with the unique id of the board of each beacon; spare ones are left out."""
        ids = {place_of(bytes.fromhex(line["unique_id"])): line["unique_id"] for line in listed}
        head, *tables = site_toml(self.scenario).split("[[beacon]]")
        named = [f'\nboard = "{ids[i + 1]}"{table}' for i, table in enumerate(tables[: len(self.sited)])]
        path.write_text("[[beacon]]".join([head, *named]))

    def energised(self):
        """Numbers, in the scenario, of the beacons whose bridge was enabled since this was asked before."""
        found = set()
        for beacon in self.scenario.beacons:
            changes = self.rig.pin_changes(beacon.node)
            if np.any((changes["pin"] == PIN_ENABLE) & changes["level"]):
                found.add(beacon.node)
        return found
