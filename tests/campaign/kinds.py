"""The kinds of faults: what begins each, and what mends it. A generator of the trial's seed draws where it strikes."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np

from goldfield_protocol import encode
from goldfield_protocol.parameters import PARAMETERS
from hil_sim.rig import Rig
from hil_sim.scenario import Ambient, Bring, Clock, Move, Scenario
from hil_sim.scenario.parts import Impulses, Mains
from hil_sim.world.magnet import Magnet
from hil_sim.world.roaming import Roaming
from hil_sim.world.sheet import Sheet
from tests.campaign import links
from tests.campaign.carried import CARRIED
from tests.campaign.host_kinds import HOST
from tests.campaign.trial import FAULT_S, HIGH_M, LOW_M, RATE_RAD_S, SPEED_M_S, Kind, Trial
from tests.campaign.wire_kinds import GLITCHES, WIRES, quiet

AWAY_S = 1000.0
"""A board that is to stay dead gets its power back so much later, or when somebody gives it."""


def direction(random: np.random.Generator) -> Any:
    """Draw a direction, shape (3,)."""
    drawn = random.normal(size=3)
    return drawn / np.linalg.norm(drawn)


# ---- The sensor's front end and converters ----


def axis(fault: str, value: float = 0.0) -> Kind:
    """Return the kind by which one axis fails."""

    def begin(trial: Trial) -> None:
        trial.notes["axis"] = int(trial.random.integers(3))
        trial.rig.sensor_fault(trial.notes["axis"], fault, value)

    name = f"axis {fault}" + (f" {value:g}" if fault in ("gain", "bit_high", "bit_low") else "")
    return Kind("sensor", name, begin, lambda trial: trial.rig.sensor_fault(trial.notes["axis"], "sound"))


def all_axes(name: str, *faults: tuple[str, float]) -> Kind:
    """Return the kind by which all axes fail, each in its way."""

    def begin(trial: Trial) -> None:
        for number, (fault, value) in enumerate(faults):
            trial.rig.sensor_fault(number, fault, value)

    def end(trial: Trial) -> None:
        for number in range(3):
            trial.rig.sensor_fault(number, "sound")

    return Kind("sensor", name, begin, end)


SENSOR = [
    *(axis(fault) for fault in ("held", "low", "high")),
    *(axis("gain", value) for value in (-1.0, 0.5, 0.8, 0.95, 1.2, 2.0)),
    *(axis("bit_high", bit) for bit in (11.0, 8.0, 4.0)),
    *(axis("bit_low", bit) for bit in (10.0, 6.0)),
    all_axes("all axes low", *[("low", 0.0)] * 3),
    all_axes("all axes reversed", *[("gain", -1.0)] * 3),
    all_axes("all gains 1.2", *[("gain", 1.2)] * 3),
    all_axes("two axes swapped", ("other_axis", 1.0), ("other_axis", 0.0), ("sound", 0.0)),
    all_axes("axes rotated", ("other_axis", 1.0), ("other_axis", 2.0), ("other_axis", 0.0)),
    all_axes("two axes held", ("held", 0.0), ("held", 0.0), ("sound", 0.0)),
]

# ---- Surroundings ----


def surroundings(name: str, **changes: Any) -> Kind:
    """Return the kind by which the ambient fields become others."""

    def begin(trial: Trial) -> None:
        trial.rig.surround(replace(trial.scenario.ambient, **changes))

    return Kind("surroundings", name, begin, lambda trial: trial.rig.surround(trial.scenario.ambient))


def earth(step_T: float) -> Kind:
    """Return the kind by which the constant field jumps."""

    def begin(trial: Trial) -> None:
        ambient: Ambient = trial.scenario.ambient
        trial.rig.surround(replace(ambient, earth_T=ambient.earth_T + step_T * direction(trial.random)))

    def end(trial: Trial) -> None:
        trial.rig.surround(trial.scenario.ambient)

    return Kind("surroundings", f"constant field jumps {step_T * 1e6:g} uT", begin, end)


def passing(name: str, moment_A_m2: float, nearest_m: float, speed_m_per_s: float) -> Kind:
    """Return the kind by which a magnet passes where the sensor is in the middle of the fault."""

    def plan(scenario: Scenario, at_s: float, until_s: float, random: np.random.Generator) -> Scenario:
        middle_s = 0.5 * (at_s + until_s)
        place = scenario.motion.poses(np.array([middle_s]))[0][0]
        along, beside = direction(random), direction(random)
        beside -= along * (along @ beside)
        beside /= np.linalg.norm(beside)
        start = place + nearest_m * beside - speed_m_per_s * (middle_s - at_s) * along
        magnet = Magnet(moment_A_m2 * direction(random), start, speed_m_per_s * along, at_s, until_s)
        return replace(scenario, magnets=(magnet,))

    return Kind("surroundings", name, plan=plan)


def sheet(name: str, side_m: float, distance_m: float) -> Kind:
    """Return the kind by which a sheet of metal stands beside the walked room, and stays."""

    def plan(scenario: Scenario, at_s: float, until_s: float, random: np.random.Generator) -> Scenario:
        centre = np.array([LOW_M[0] - distance_m, float(random.uniform(0.7, 1.4)), float(random.uniform(0.6, 1.2))])
        return replace(scenario, events=(Bring(at_s, Sheet(centre, np.array([1.0, 0.0, 0.0]), side_m)),))

    return Kind("surroundings", name, plan=plan)


NOISY_MAINS = Mains(50.0, np.array([3e-6, 2e-6, 1e-6]), (1.0, 0.0, 0.3, 0.0, 0.2), 0.0)
SURROUNDINGS = [
    surroundings("mains 4 uT with harmonics", mains=NOISY_MAINS),
    surroundings("traction current 16.7 Hz 20 uT", mains=Mains(50.0 / 3.0, np.array([2e-5, 0.0, 0.0]), (1.0,), 0.0)),
    surroundings("impulses 30/s of 20 uT", impulses=Impulses(30.0, 2e-5)),
    surroundings("impulses 1/s of 1 mT", impulses=Impulses(1.0, 1e-3)),
    *(earth(step) for step in (5e-6, 5e-5)),
    passing("loudspeaker passes at 0.3 m", 10.0, 0.3, 1.0),
    passing("car passes at 2 m", 300.0, 2.0, 3.0),
    passing("magnet passes at 0.1 m", 3.0, 0.1, 0.5),
    sheet("sheet of 0.5 m comes", 0.5, 0.15),
    sheet("sheet of 1.5 m comes", 1.5, 0.3),
]

# ---- Beacons: coils, drivers, boards ----


def struck(fault: str) -> Kind:
    """Return the kind by which something of one beacon breaks."""

    def begin(trial: Trial) -> None:
        trial.notes["board"] = trial.follower()
        trial.rig.fault(trial.notes["board"], fault)

    def end(trial: Trial) -> None:
        trial.rig.fault(trial.notes["board"], fault, active=False)
        trial.clear(trial.notes["board"])

    return Kind("beacon", fault, begin, end)


def moved(*steps_m: float) -> Kind:
    """Return the kind by which beacons are moved, each by so much, and stay so."""

    def plan(scenario: Scenario, at_s: float, until_s: float, random: np.random.Generator) -> Scenario:
        which = random.choice(len(scenario.beacons), len(steps_m), replace=False)
        moves = [
            Move(at_s, scenario.beacons[number].id, step * direction(random))
            for number, step in zip(which, steps_m, strict=True)
        ]
        return replace(scenario, events=tuple(moves))

    return Kind("beacon", "moved " + " and ".join(f"{step:g} m" for step in steps_m), plan=plan)


def supply(share: float) -> Kind:
    """Return the kind by which the supply of a coil falls to a share."""

    def begin(trial: Trial) -> None:
        trial.notes["board"] = board = trial.follower()
        trial.notes["supply_V"] = trial.scenario.beacons[board - 1].circuit.supply_V
        trial.rig.set_supply_V(board, share * trial.notes["supply_V"])

    def end(trial: Trial) -> None:
        trial.rig.set_supply_V(trial.notes["board"], trial.notes["supply_V"])
        trial.clear(trial.notes["board"])

    return Kind("beacon", f"supply falls to {100 * share:g} %", begin, end)


def dead(name: str, boards: Callable[[Trial], list[int]], lasts_s: float = FAULT_S) -> Kind:
    """Return the kind by which boards lose their power, and get it back."""

    def begin(trial: Trial) -> None:
        trial.notes["boards"] = boards(trial)
        for board in trial.notes["boards"]:
            trial.rig.power_cycle(board, AWAY_S)

    def end(trial: Trial) -> None:
        for board in trial.notes["boards"]:
            trial.rig.power_cycle(board, float(trial.random.uniform(0.0, 0.02)))

    return Kind("beacon", name, begin, end, lasts_s=lasts_s)


def reset(name: str, boards: Callable[[Trial], list[int]], off_s: float = 0.05) -> Kind:
    """Return the kind by which boards lose their power for a moment."""

    def begin(trial: Trial) -> None:
        for board in boards(trial):
            trial.rig.power_cycle(board, off_s)

    return Kind("beacon", name, begin, lasts_s=off_s + 0.05)


def turned(fault: str, name: str) -> Kind:
    """Return the kind by which a beacon is reset while its wires are exchanged, and again to mend them."""

    def begin(trial: Trial) -> None:
        trial.notes["board"] = trial.follower()
        trial.rig.fault(trial.notes["board"], fault)
        trial.rig.power_cycle(trial.notes["board"], 0.05)

    def end(trial: Trial) -> None:
        trial.rig.fault(trial.notes["board"], fault, active=False)
        trial.rig.power_cycle(trial.notes["board"], 0.05)

    return Kind("beacon", name, begin, end)


def some(count: int) -> Callable[[Trial], list[int]]:
    """Return what draws so many beacons that do not lead."""
    return lambda trial: [int(board) for board in 2 + trial.random.choice(trial.beacons - 1, count, replace=False)]


def told(name: str, parameter: str, value: Callable[[Trial, int], float]) -> Kind:
    """Return the kind by which a stranger sets a parameter of a beacon, which is reset later."""

    def begin(trial: Trial) -> None:
        trial.notes["board"] = board = trial.follower()
        described = PARAMETERS[parameter]
        signals = {"kind": int(described.kind), f"value_{described.kind.name.lower()}": value(trial, board)}
        node = trial.scenario.beacons[board - 1].node
        trial.rig.can_write(*encode("PARAM_SET", signals, node=node, index=described.first))

    return Kind("beacon", name, begin, lambda trial: trial.rig.power_cycle(trial.notes["board"], 0.01))


BEACONS = [
    *(
        struck(fault)
        for fault in (
            *("coil_open", "coil_shorted", "coil_hot", "driver_runaway", "driver_stuck", "sense_shorted"),
            *("sense_held", "driver", "driver_hot", "pull_downs_lost", "bridge_swapped"),
        )
    ),
    moved(0.02),
    moved(0.1),
    moved(1.0),
    moved(0.1, 0.1),
    moved(0.1, 0.1, 0.1),
    supply(0.6),
    supply(0.0),
    dead("one dies", some(1)),
    dead("two die", some(2)),
    dead("four die", some(4)),
    dead("the sync master dies", lambda trial: [trial.scenario.sync_master]),
    dead("the sync master is dead for 30 s", lambda trial: [trial.scenario.sync_master], 30.0),
    dead("all die", lambda trial: list(range(1, 1 + trial.beacons))),
    reset("one is reset", some(1)),
    reset("the sync master is reset", lambda trial: [trial.scenario.sync_master]),
    reset("all are reset", lambda trial: list(range(1, 1 + trial.beacons))),
    turned("bridge_swapped", "comes back with its bridge swapped"),
    turned("coil_reversed", "comes back with its coil reversed"),
    told("a stranger sets half the amplitude", "amplitude", lambda trial, board: 5.0),
]

# ---- Time ----


def cut(board: Callable[[Trial], int], name: str) -> Kind:
    """Return the kind by which a board no longer has the sync wire."""

    def begin(trial: Trial) -> None:
        trial.notes["board"] = board(trial)
        trial.rig.fault(trial.notes["board"], "sync_wire_cut")

    def end(trial: Trial) -> None:
        trial.rig.fault(trial.notes["board"], "sync_wire_cut", active=False)

    return Kind("time", name, begin, end)


def comes_back(name: str, ppm: float) -> Kind:
    """Return the kind by which the sensor is reset, and comes back with another crystal."""
    begin = lambda trial: trial.rig.power_cycle_sensor(0.05, Clock(crystal_ppm=ppm))  # noqa: E731
    return Kind("time", name, begin, lambda trial: trial.rig.power_cycle_sensor(0.05, Clock()))


def second_master(name: str, ahead: int) -> Kind:
    """Return the kind by which a stranger on the bus numbers the cycles otherwise, ten times a second."""

    def begin(trial: Trial) -> None:
        def spoil(frames: Any) -> Any:
            signals = {"cycle": int(trial.rig.now_s * 10.0) + ahead, "chips": 1023, "chip_period": 97.75, "rank": 0}
            trial.rig.can_write(*encode("SYNC", signals, node=77, index=0))
            return frames

        trial.link.spoil = spoil

    return Kind("time", name, begin, quiet)


def with_deputy(scenario: Scenario, at_s: float, until_s: float, random: np.random.Generator) -> Scenario:
    """Let the second beacon be the sync master's deputy."""
    first, second, *others = scenario.beacons
    return replace(scenario, beacons=(first, replace(second, sync_rank=2), *others))


def two_masters() -> Kind:
    """Return the kind by which the sync master and its deputy start at once, the deputy with the rank of a master."""

    def begin(trial: Trial) -> None:
        off_s = float(trial.random.uniform(0.05, 0.15))
        trial.rig.power_cycle(trial.scenario.sync_master, off_s)
        trial.rig.power_cycle(2, off_s, sync_master=1)

    return Kind("time", "two sync masters start at once", begin, plan=with_deputy, lasts_s=1.0, by_arrival=True)


def time_of_its_own() -> Kind:
    """Return the kind by which a beacon starts that hears nobody and nobody hears, and leads a time of its own."""

    def begin(trial: Trial) -> None:
        for fault in ("sync_wire_cut", "can_cut"):
            trial.rig.fault(2, fault)
        trial.rig.power_cycle(2, 0.05)

    def end(trial: Trial) -> None:
        for fault in ("sync_wire_cut", "can_cut"):
            trial.rig.fault(2, fault, active=False)
        trial.rig.power_cycle(2, 0.05)

    return Kind("time", "a beacon has a time of its own, unheard", begin, end, with_deputy, by_arrival=True)


TIME = [
    cut(lambda trial: 0, "sensor's sync wire cut"),
    cut(lambda trial: trial.follower(), "a beacon's sync wire cut"),
    comes_back("sensor comes back 50 ppm off", 50.0),
    comes_back("sensor comes back 400 ppm off", 400.0),
    Kind("time", "sensor is reset", lambda trial: trial.rig.power_cycle_sensor(0.05), lasts_s=0.1),
    Kind("time", "sensor has no power for 3 s", lambda trial: trial.rig.power_cycle_sensor(3.0)),
    second_master("a stranger numbers the cycles", 500),
    two_masters(),
    time_of_its_own(),
]

# ---- Links ----


def spoilt(name: str, spoil: Callable[[np.random.Generator], links.Spoil], *, serial: bool) -> Kind:
    """Return the kind by which what the host gets is spoilt."""

    def begin(trial: Trial) -> None:
        trial.link.spoil = spoil(trial.random)

    return Kind("serial" if serial else "CAN", name, begin, quiet, serial=serial)


def flooded(name: str, identifier: int) -> Kind:
    """Return the kind by which a node that babbles asks for the bus all the time."""

    def begin(trial: Trial) -> None:
        def spoil(frames: Any) -> Any:
            for _ in range(100):
                trial.rig.can_write(identifier, bytes(8))
            return [frame for frame in frames if frame.identifier != identifier]

        trial.link.spoil = spoil

    return Kind("CAN", name, begin, quiet, lasts_s=1.0)


def errors(probability: float) -> Kind:
    """Return the kind by which bits on the bus are wrong."""
    begin = lambda trial: trial.rig.can_errors(probability)  # noqa: E731
    return Kind("CAN", f"bit errors {probability:g}", begin, lambda trial: trial.rig.can_errors(0.0))


def again(trial: Trial) -> None:
    """Let the sensor's frames of half a second ago come once more."""
    kept: list[Any] = []
    node = trial.scenario.sensor.node

    def spoil(frames: Any) -> Any:
        kept.append([frame for frame in frames if frame.identifier & 0xFFF == node])
        return [*frames, *(kept.pop(0) if len(kept) > 25 else [])]

    trial.link.spoil = spoil


def twin(trial: Trial) -> None:
    """Let a second sensor have the first one's number: that of a bench of its own, which roams on another path."""
    motion = Roaming(trial.seed + 1000, LOW_M, HIGH_M, SPEED_M_S, RATE_RAD_S)
    second = Rig(replace(trial.scenario, motion=motion, seed=trial.seed + 1000), trial.boards)
    trial.notes["second"] = second
    second.advance(trial.rig.now_s)
    second.can_read()
    node = trial.scenario.sensor.node

    def spoil(frames: Any) -> Any:
        second.advance(max(trial.rig.now_s - second.now_s, 0.0))
        others = [frame for frame in second.can_read() if frame.identifier & 0xFFF == node]
        return sorted([*frames, *others], key=lambda frame: frame.time_s)

    trial.link.spoil = spoil


def twin_gone(trial: Trial) -> None:
    """Take the second sensor away."""
    quiet(trial)
    trial.notes["second"].close()


def paused(trial: Trial) -> None:
    """Let the host sleep as long as the fault lasts: the boards go on, and what the link keeps comes in one piece."""
    trial.rig.advance(trial.kind.lasts_s)


BABBLE_FIRST, BABBLE_LAST = 0x00000000, 0x1FFFFFFF
LINKS = [
    errors(1e-5),
    errors(1e-3),
    flooded("a node babbles with the first right", BABBLE_FIRST),
    flooded("a node babbles with the last right", BABBLE_LAST),
    Kind("CAN", "the sensor's frames come again", again, quiet),
    Kind("CAN", "a second sensor of one number", twin, twin_gone),
    Kind("CAN", "the host sleeps", paused),
    Kind("serial", "the host sleeps", paused, serial=True),
    *(
        spoilt(name, spoil, serial=serial)
        for serial in (False, True)
        for name, spoil in (
            ("a tenth is lost", lambda random: links.thinned(0.1, random)),
            ("half is lost", lambda random: links.thinned(0.5, random)),
            ("nothing comes", lambda random: links.silent),
            ("everything comes twice", lambda random: links.doubled),
        )
    ),
    spoilt("a bit of each hundredth byte flips", lambda random: links.flipped(0.01, random), serial=True),
    spoilt("a bit of each tenth byte flips", lambda random: links.flipped(0.1, random), serial=True),
    spoilt("noise between the frames", lambda random: links.noisy(50, random), serial=True),
]

# ---- Pairs ----


def pair(first: Kind, second: Kind) -> Kind:
    """Return the kind by which two things go wrong at once."""

    def begin(trial: Trial) -> None:
        first.begin(trial)
        trial.notes["second"] = {}
        trial.notes, kept = trial.notes["second"], trial.notes
        second.begin(trial)
        trial.notes, trial.notes["first"] = trial.notes, kept

    def end(trial: Trial) -> None:
        kept = trial.notes
        second.end(trial)
        trial.notes = kept["first"]
        first.end(trial)

    serial = first.serial or second.serial
    return Kind("pair", f"{first.name} + {second.name}", begin, end, first.plan or second.plan, serial=serial)


def one(kinds: list[Kind], name: str) -> Kind:
    """Return the kind of this name."""
    return next(kind for kind in kinds if kind.name == name)


PAIRS = [
    pair(one(BEACONS, "one dies"), one(BEACONS, "moved 0.1 m")),
    pair(one(BEACONS, "one dies"), one(TIME, "sensor's sync wire cut")),
    pair(one(BEACONS, "coil_open"), one(SENSOR, "axis gain 1.2")),
    pair(one(BEACONS, "the sync master dies"), one(LINKS, "bit errors 1e-05")),
    pair(one(SURROUNDINGS, "mains 4 uT with harmonics"), one(BEACONS, "moved 1 m")),
    pair(one(TIME, "a beacon's sync wire cut"), one(BEACONS, "one dies")),
    pair(one(GLITCHES, "50 glitches/s of 100 us"), one(BEACONS, "one dies")),
]

NOTHING = Kind("none", "nothing")
KINDS = [NOTHING, *SENSOR, *SURROUNDINGS, *CARRIED, *BEACONS, *TIME, *WIRES, *LINKS, *HOST, *PAIRS]
