"""Trials of a workload: it is started once, and each trial strikes a copy of the process at its moment.

A copy is a ``fork()``: the chip, the coil and all that came out of the board so far lie in this process's memory, so
the copy goes on from the very instruction, and its end leaves no trace in the next one.
"""

from __future__ import annotations

import json
import os
import random
import select
import signal
import traceback
from collections.abc import Callable, Iterable, Iterator
from dataclasses import asdict, dataclass
from typing import Any

from goldfield_protocol.messages import database
from hil_sim.emulator.emulator import Emulator
from tests.command import end_with_parent
from tests.image_faults.image import instructions, name_of, place_of, text_of
from tests.image_faults.workload import Seen, Verdict, Workload

LONGEST_S = 120
"""Processor time after which a trial that does not end is ended, s."""
AHEAD_PS = 400_000
"""A copy is made so long before the instruction: Unicorn does not stop within an IT block."""
REGISTERS = 16
FLAGS = range(27, 32)
"""Q, V, C, Z and N."""
NOT_STRUCK = "not struck"


@dataclass(frozen=True)
class Upset:
    """One upset: an instruction that is skipped, a bit of a register before one, or a bit of RAM at a time."""

    workload: str
    kind: str
    address: int
    time_ps: int
    register: int = 0
    bit: int = 0

    @property
    def id(self) -> str:
        """What runs it again."""
        more = "" if self.kind == "skip" else f"/{self.bit}" if self.kind == "ram" else f"/{self.register}/{self.bit}"
        return f"{self.workload}/{self.kind}/{self.address:08x}{more}"

    def arm(self, chip: Emulator) -> None:
        """Let it strike."""
        if self.kind == "skip":
            chip.skip(self.address)
        elif self.kind == "flip":
            chip.flip(self.address, self.register, 1 << self.bit)
        else:
            chip.flip_memory(self.address, 1 << self.bit)


@dataclass(frozen=True)
class Outcome:
    """What became of an upset."""

    id: str
    image: str
    module: str
    function: str
    verdict: str
    why: str


def copied(work: Callable[[], Any]) -> tuple[int, int]:
    """Do work in a copy of this process; return its id and where its result comes from, as JSON."""
    read, write = os.pipe()
    process = os.fork()
    if process:
        os.close(write)
        return process, read
    end_with_parent()
    signal.setitimer(signal.ITIMER_PROF, LONGEST_S)
    signal.signal(signal.SIGPROF, signal.SIG_DFL)
    try:
        os.close(read)
        try:
            result = work()
        except Exception:
            result = {"error": traceback.format_exc()}
        with os.fdopen(write, "w") as file:
            json.dump(result, file)
    finally:
        os._exit(0)


def result_of(process: int, source: int) -> Any:
    """Wait for a copy, and return its result; None: it has come to no end."""
    with os.fdopen(source) as file:
        text = file.read()
    os.waitpid(process, 0)
    return json.loads(text) if text else None


# ---- Which there are ----


def visited(workload: Workload, bench: Any) -> tuple[dict[int, int], Seen]:
    """Return when each instruction of a workload's modules runs first, and what is seen without an upset."""

    def work() -> Any:
        chip = workload.chip(bench)
        text = text_of(workload.image)
        chip.begin_visits(text.start, text.stop)
        seen = workload.observe(bench)
        return [list(chip.visits().items()), seen]

    visits, seen = result_of(*copied(work))
    own = instructions(workload.image)
    end = seen.get("end_ps", 1 << 62)
    first = {
        at: time for at, time in visits if at in own and own[at].module in workload.modules and workload.begin <= time
    }
    return {at: time for at, time in first.items() if time < end}, seen


def skips(workload: Workload, visits: dict[int, int]) -> list[Upset]:
    """Return a skip of each instruction."""
    return [Upset(workload.name, "skip", at, time) for at, time in visits.items()]


def flips(workload: Workload, visits: dict[int, int], rounds: int) -> list[Upset]:
    """Return a flip of each bit of each register, each round before other instructions."""
    bits = [(register, bit) for register in range(REGISTERS) for bit in range(register == 15, 32)]
    bits += [(16, bit) for bit in FLAGS]
    places = sorted(visits.items())
    found = []
    for number in range(rounds):
        drawn = random.Random(f"{workload.name} {number}")
        for register, bit in bits:
            at, time = places[drawn.randrange(len(places))]
            found.append(Upset(workload.name, "flip", at, time, register, bit))
    return found


CONTROL = ("current", "fall", "start", "channels", "settings", "wanted", "phase", "planned", "start_chip", "latch")
CONTROL += ("channel", "limits", "halve_from", "halve_to", "no_waveform", "several_levels")
"""What of the drive's state decides, and is not a table of levels."""


def flips_of_memory(workload: Workload) -> list[Upset]:
    """Return a flip of each bit of the drive's control state, at the begin."""
    places = [at for name in CONTROL for at in place_of(workload.image, f"beacon.drive.{name}")]
    return [Upset(workload.name, "ram", at, workload.begin, 0, bit) for at in places for bit in range(8)]


# ---- Running them ----


def outcome_of(workload: Workload, upset: Upset, result: Any) -> Outcome:
    """Return the outcome of an upset from what its copy has handed back."""
    instruction = instructions(workload.image).get(upset.address)
    if result is None:
        verdict, why = "error", "the trial came to no end"
    elif "error" in result:
        verdict, why = "error", result["error"]
    else:
        verdict, why = result["verdict"], result["why"]
    module = instruction.module if instruction is not None else "ram"
    function = instruction.function if instruction is not None else "drive"
    return Outcome(upset.id, name_of(workload.image), module, function, verdict, why)


def try_one(workload: Workload, bench: Any, upset: Upset, sound: Seen) -> Any:
    """Let an upset strike, and return the verdict."""
    chip = workload.chip(bench)
    upset.arm(chip)
    seen = json.loads(json.dumps(workload.observe(bench)))  # As what is sound has come.
    verdict = workload.judge(seen, sound)
    if upset.kind != "ram" and not chip.struck():
        verdict = Verdict(NOT_STRUCK)
    return {**asdict(verdict), "seen": seen}


def run(workload: Workload, bench: Any, upsets: Iterable[Upset], sound: Seen, processes: int) -> Iterator[Outcome]:
    """Run upsets in the order of their moments, and yield each outcome as it comes."""
    chip = workload.chip(bench)
    under_way: dict[int, tuple[int, Upset]] = {}

    def finish() -> Iterator[Outcome]:
        ready, _, _ = select.select(list(under_way), [], [])
        for source in ready:
            process, upset = under_way.pop(source)
            yield outcome_of(workload, upset, result_of(process, source))

    for upset in sorted(upsets, key=lambda one: one.time_ps):
        while len(under_way) >= processes:
            yield from finish()
        if upset.time_ps - AHEAD_PS > chip.now_ps:
            chip.run(upset.time_ps - AHEAD_PS)
        process, source = copied(lambda upset=upset: try_one(workload, bench, upset, sound))  # type: ignore[misc]
        under_way[source] = (process, upset)
    while under_way:
        yield from finish()


def ready(workload: Workload) -> tuple[Any, dict[int, int], Seen]:
    """Start a workload; return its bench at its begin, what may be struck there, and what is seen if nothing is."""
    database()  # Once, and not in each copy.
    bench = workload.start()
    if workload.begin > 0:
        workload.chip(bench).run(workload.begin)
    visits, seen = visited(workload, bench)
    return bench, visits, seen
