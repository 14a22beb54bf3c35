"""Benches of one machine, with a garbage sender beside them: none hears another, and no stranger disturbs one."""

from __future__ import annotations

import contextlib
import json
import re
import select
import subprocess
import sys

import can
import pytest

from goldfield import site as sites
from goldfield.access.epoch import EpochSeparator
from goldfield.link.can_channel import open_channel
from goldfield.link.reports import Assembler
from goldfield.link.serial_bus import SerialBus
from goldfield.locate import locate
from goldfield.types import Status
from goldfield_protocol import FrameDecoder, decode, encode
from hil_sim.clib import ROOT
from hil_sim.links.can_bridge import OWN, CanBridge
from hil_sim.links.pseudo_terminal import PseudoTerminal
from hil_sim.links.serve import SLICE_S
from hil_sim.rig import Rig
from hil_sim.scenario import load_scenario, site_toml
from tests.hil.garbage_sender import AT_A_CHANNEL, GarbageSender

SCENARIO = "prigge8"
SENSOR_NODE = 100
BOOTED_S = 2.5


class ServedBench:
    """A rig with its links as ``goldfield hil`` serves them, in virtual time, and a reader at each link."""

    def __init__(self, seed):
        self.rig = Rig(load_scenario(SCENARIO), "host", seed)
        self.rig.advance(BOOTED_S)
        self.rig.serial_read(), self.rig.can_read()
        self.bridge, self.terminal = CanBridge(OWN), PseudoTerminal()
        self.on_can = open_channel(*self.bridge.channel.split(":", 1))
        self.on_serial = SerialBus(self.terminal.path)
        self.frames, self.stream = [], bytearray()
        self.heard_on_can, self.heard_on_serial = [], []
        self._read, self.rig.can_read = self.rig.can_read, self._can_read

    def _can_read(self):
        frames = self._read()
        self.frames += frames
        return frames

    def step(self):
        self.rig.serial_write(self.terminal.read())
        self.bridge.to_boards(self.rig)
        self.rig.advance(SLICE_S)
        sent = self.rig.serial_read()
        self.stream += sent
        self.terminal.write(sent, wait=True)
        self.bridge.to_host(self.rig)
        self.heard_on_can += messages(self.on_can)
        self.heard_on_serial += messages(self.on_serial)

    def close(self):
        for link in (self.on_serial, self.on_can):
            link.shutdown()
        for part in (self.terminal, self.bridge, self.rig):
            part.close()


def messages(bus, count=None):
    """What waits on a bus, as (identifier, data); or so many messages, for which it waits."""
    got = []
    while count is None or len(got) < count:
        message = bus.recv(0.0 if count is None else None)
        if message is None:
            break
        got.append((message.arbitration_id, bytes(message.data)))
    return got


def poses_of(site, heard):
    """The poses that a reader makes of messages of the sensor."""
    assembler, separator = Assembler(), EpochSeparator(site)
    reports = []
    for identifier, data in heard:
        message = decode(identifier, data)
        if message is not None and message.node == SENSOR_NODE:
            reports += assembler.feed(message, 0.0)
    whole = [report for report in reports if report.complete]
    return reports, [locate(site, separator.fields(report)) for report in whole]


@pytest.mark.parametrize("count", [2, 4])
def test_every_reader_hears_its_own_bench_in_order(count, tmp_path):
    (tmp_path / "site.toml").write_text(site_toml(load_scenario(SCENARIO)))
    site = sites.load(tmp_path / "site.toml")
    benches = [ServedBench(seed) for seed in range(count)]
    garbage = GarbageSender([bench.bridge.channel.split(":", 1)[1] for bench in benches])
    slices = 300
    for number in range(slices):
        garbage.throw()
        for seed, bench in enumerate(benches):
            if number % 100 == 50 and seed % 2:  # every second bench is asked something by its reader
                bench.on_can.send(can.Message(arbitration_id=encode("PARAM_GET", {"reserved": 0}, node=1, index=0)[0]))
            bench.step()
    for seed, bench in enumerate(benches):
        sent = [(f.identifier, f.data) for f in bench.frames if f.board != bench.rig.host_node and f.acknowledged]
        bench.heard_on_can += messages(bench.on_can, len(sent) - len(bench.heard_on_can))
        assert bench.heard_on_can == sent
        sent = [(frame.identifier, frame.data) for frame in FrameDecoder().feed(bytes(bench.stream))]
        bench.heard_on_serial += messages(bench.on_serial, len(sent) - len(bench.heard_on_serial))
        assert bench.heard_on_serial == sent
        while bench.bridge.refused < AT_A_CHANNEL * slices:  # the last may arrive after they were thrown
            select.select([bench.bridge._bus.fileno()], [], [])
            bench.bridge.to_boards(bench.rig)
        asked = 3 if seed % 2 else 0
        assert (bench.bridge.taken, bench.bridge.refused) == (asked, AT_A_CHANNEL * slices)
        assert (bench.bridge.lost, bench.on_serial.bad_frames, bench.terminal.lost) == (0, 0, 0)
        for heard in (bench.heard_on_can, bench.heard_on_serial):
            reports, poses = poses_of(site, heard)
            cycles = [report.cycle for report in reports]
            assert cycles == list(range(cycles[0], cycles[0] + len(cycles)))
            assert len(poses) >= 13
            assert {pose.status for pose in poses} == {Status.OK}
    assert len({bytes(bench.stream) for bench in benches}) == count  # benches of different seeds: none was mistaken
    for bench in benches:
        bench.close()


# ---- The same in processes, by the wall clock ----

SECONDS = 60
GRANTED = 1000
"""One false alarm is granted to so many epochs."""


def goldfield(*words):
    command = [sys.executable, "-m", "goldfield", *map(str, words)]
    return subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, cwd=ROOT)


def reader(link, site, seconds):
    return goldfield("run", f"--{link[0]}", link[1], "--site", site, "--json", "--seconds", seconds)


@pytest.mark.slow
@pytest.mark.parametrize("count", [2, 4])
def test_a_minute_beside_a_garbage_sender(count, tmp_path):
    """One reader a bench, by serial port and by CAN in turn."""
    processes = contextlib.ExitStack()
    with processes:

        def start(process):
            processes.callback(process.kill)
            return process

        sites, links, benches, channels = [], [], [], []
        for seed in range(count):
            sites.append(tmp_path / f"site{seed}.toml")
            options = ("--seed", seed, "--can", OWN, "--link", tmp_path / f"port{seed}", "--site", sites[-1])
            options += ("--truth", tmp_path / f"truth{seed}.jsonl")
            benches.append(start(goldfield("hil", SCENARIO, "--boards", "host", "--json", *options)))
            first = json.loads(benches[-1].stdout.readline())
            links.append(("can", first["can"]) if seed % 2 else ("port", first["serial"]))
            channels.append(first["can"].split(":", 1)[1])
        sender = [sys.executable, "-m", "tests.hil.garbage_sender", *channels]
        garbage = subprocess.Popen(sender, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True, cwd=ROOT)
        start(garbage)
        readers = [start(reader(link, site, SECONDS)) for link, site in zip(links, sites, strict=True)]
        outputs = [each.communicate() for each in readers]
        thrown = int(garbage.communicate()[0])
        for link, site in zip(links, sites, strict=True):
            start(reader(link, site, 0.5)).communicate()  # the benches have gone on: they have seen all that was thrown
        for bench in benches:
            bench.terminate()
        ends = [bench.communicate()[1] for bench in benches]
    alarms = []
    for seed, (out, err) in enumerate(outputs):
        assert readers[seed].returncode == 0, err
        lines = [json.loads(line) for line in out.splitlines()]
        epochs = [line["epoch"] for line in lines]
        alarms += (bad := [(seed, line["epoch"], line["reason"]) for line in lines if line["status"] != "ok"])
        ok = len(lines) - len(bad)
        print(f"\nbench {seed} of {count} by {links[seed][0]}: {ok} of {len(lines)} ok; {ends[seed].strip()}")
        assert epochs == list(range(epochs[0], epochs[0] + len(epochs)))
        assert len(epochs) == pytest.approx(10 * SECONDS, abs=1)
        assert sum(line["lost"] for line in lines) == 0
        assert int(re.search(r"CAN: \d+ frames from outside, (\d+) refused", ends[seed])[1]) == thrown > 0
    print(*alarms, sep="\n")
    assert len(alarms) <= 2 + 3 * count * 10 * SECONDS / GRANTED
