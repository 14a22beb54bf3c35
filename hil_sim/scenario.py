"""Scenario files: what the rig simulates, in TOML and SI units; ``scenarios/prigge8.toml`` is a commented example."""

from __future__ import annotations

import math
import tomllib
from collections.abc import Callable, Mapping
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from goldfield.drive import DEGREES, Code, Plan, read_drive
from goldfield.errors import UserError
from goldfield.toml_table import Table, text_lines
from goldfield_protocol.parameters import ParameterError, Value, build_page
from hil_sim.world.motion import Line, Motion, Still, Waypoints
from hil_sim.world.path import CoilGeometry

FloatArray = NDArray[np.float64]

SCENARIOS = Path(__file__).parent / "scenarios"
CHIP_TICKS, TICKS_PER_SECOND = 16422, 168e6
DEGREE = 10
"""Of the codes, unless the scenario says otherwise: the boards' default."""
CODES_MAX = 4
"""Superposed codes of a beacon, a limit of the boards."""
SQUARE_TOLERANCE = 1e-3
"""Cosine of the angle between crossed coils that still counts as none: coils that lean more would couple."""
CHIP_PERIOD_S = CHIP_TICKS / TICKS_PER_SECOND
CONVERTER_COUNTS = 4096
HARMONICS = 16
LEAST_NOISE_T = 1e-9
"""What the sensor takes for its noise in a scenario without any: the converters' steps remain."""
ZERO = np.zeros(3)


@dataclass(frozen=True)
class Circuit:
    """A coil's electrical side and its driver.

    Attributes
    ----------
    current_A : float
        Amplitude in the board's parameters.
    inductance_H, resistance_Ohm, supply_V : float
    reference_gain_error, sense_gain_error : float
        Relative errors of the driver's set-point and of the current sense.
    sense_noise_A : float
        Standard deviation of one look at the current.
    """

    current_A: float
    inductance_H: float
    resistance_Ohm: float
    supply_V: float
    reference_gain_error: float = 0.0
    sense_gain_error: float = 0.0
    sense_noise_A: float = 0.005


@dataclass(frozen=True)
class Clock:
    """A board's oscillators, processor and power.

    Attributes
    ----------
    crystal_ppm, internal_ppm : float
        Errors of crystal and internal oscillator.
    crystal_dead : bool
        The crystal never starts (emulated boards).
    temperature_degC : float
        Of the processor.
    """

    crystal_ppm: float = 0.0
    internal_ppm: float = 0.0
    crystal_dead: bool = False
    temperature_degC: float = 25.0


@dataclass(frozen=True, eq=False)
class Beacon:
    """One beacon board with its coil or coils.

    It drives its code unless it has superposed ``codes``, a time ``slot`` (pulsed direct current), ``periods`` in a
    cycle (square wave) or ``rotating_periods`` (a cosine in the coil, a sine in the ``second_coil`` that crosses it).
    """

    id: str
    node: int
    code: int | None
    sync_master: bool
    clock: Clock
    circuit: Circuit
    geometry: CoilGeometry
    slot: int | None = None
    periods: int | None = None
    rotating_periods: int | None = None
    second_coil: CoilGeometry | None = None
    codes: tuple[Code, ...] = ()

    @property
    def coils(self) -> tuple[CoilGeometry, ...]:
        """Its coils in the order of the board's channels."""
        return (self.geometry,) if self.second_coil is None else (self.geometry, self.second_coil)

    @property
    def access(self) -> str:
        """How the host tells it from others: "cdma", "tdma", or "fdma" with its tone."""
        if self.slot is not None:
            return "tdma"
        if self.periods is not None:
            return "fdma, square"
        return "cdma" if self.rotating_periods is None else "fdma, sine"

    @property
    def plain_code(self) -> int | None:
        """The code that it drives and nothing else, as a sensor board can despread it; None: there is none."""
        return self.code if self.access == "cdma" and not self.codes else None


@dataclass(frozen=True, eq=False)
class Mains:
    """Hum: ``amplitude_T * sum_h harmonics[h-1] sin(h (2 pi f t + phase_rad))``, site's frame."""

    frequency_Hz: float
    amplitude_T: FloatArray
    harmonics: tuple[float, ...]
    phase_rad: float


@dataclass(frozen=True)
class Impulses:
    """Random spikes (Poisson) of one size, random direction and exponential decay."""

    rate_Hz: float = 0.0
    amplitude_T: float = 0.0
    decay_s: float = 1e-4


@dataclass(frozen=True, eq=False)
class Ambient:
    """The field of all that is not a beacon; ``earth_T`` in the site's frame."""

    earth_T: FloatArray
    mains: Mains | None
    impulses: Impulses


@dataclass(frozen=True, eq=False)
class Sensor:
    """The sensor board and its front end.

    Attributes
    ----------
    noise_T : float
        Standard deviation of one chip's sample on one axis.
    converter_noise_LSB : float
        Standard deviation of each single conversion, in steps of the converter.
    bandwidth_Hz : float
        First-order low-pass of the front end; 0: none.
    range_T : float
        Field at the converter's ends.
    gain_error : ndarray, shape (3,)
    misalignment_rad : ndarray, shape (3,)
        Leaning of the sensitive axes: x toward y, x toward z, y toward z.
    offset_T : ndarray, shape (3,)
    calibration : str
        ``exact``: the parameter page holds the true zero and matrix; ``nominal``: those of a perfect sensor.
    stream : int
        The board's parameter: 0 fields, 1 fields and every raw chip.
    pose : int
        1: the board knows the beacons and computes its own poses; 0: it knows nothing of them.
    sync_wire : bool
        True: it follows the sync wire; False: its sync input is not connected, it follows the beacons' field.
    """

    node: int
    clock: Clock
    noise_T: float
    converter_noise_LSB: float
    bandwidth_Hz: float
    range_T: float
    gain_error: FloatArray
    misalignment_rad: FloatArray
    offset_T: FloatArray
    calibration: str
    stream: int
    pose: int
    sync_wire: bool = True

    @property
    def lag_s(self) -> float:
        """Time constant of the low-pass."""
        return 1.0 / (2.0 * math.pi * self.bandwidth_Hz) if self.bandwidth_Hz > 0.0 else 0.0

    @property
    def gain(self) -> FloatArray:
        """Sensed field = gain times field, shape (3, 3): rows are the sensitive axes times (1 + gain error)."""
        xy, xz, yz = self.misalignment_rad
        axes = np.array([[1.0, xy, xz], [0.0, 1.0, yz], [0.0, 0.0, 1.0]])
        axes /= np.linalg.norm(axes, axis=1, keepdims=True)
        return np.asarray((1.0 + self.gain_error)[:, None] * axes)

    def correction(self) -> tuple[FloatArray, FloatArray]:
        """Return zero, shape (3,), counts, and matrix, shape (3, 3), T per count, as the parameter page has them."""
        middle = CONVERTER_COUNTS / 2
        counts_per_T = middle / self.range_T
        if self.calibration == "nominal":
            return np.full(3, middle), np.eye(3) / counts_per_T
        return middle + self.offset_T * counts_per_T, np.asarray(
            np.linalg.inv(self.gain) / counts_per_T, dtype=np.float64
        )


@dataclass(frozen=True, eq=False)
class HalfSpace:
    """The side of a plane where the sensor is; for the site file."""

    point: FloatArray
    normal: FloatArray


@dataclass(frozen=True, eq=False)
class Scenario:
    """A whole scenario; board 0 is the sensor, board i the i-th beacon.

    ``sync`` is where the boards have their time from, ``wire`` or ``can``; with ``can`` there is no sync wire.
    """

    name: str
    seed: int
    power_on_spread_s: float
    half_space: HalfSpace | None
    ambient: Ambient
    sensor: Sensor
    motion: Motion
    beacons: tuple[Beacon, ...]
    slots: int = 0
    degree: int = DEGREE
    sync: str = "wire"

    @property
    def chips(self) -> int:
        """Chips in a cycle."""
        return (1 << self.degree) - 1

    @property
    def sync_master(self) -> int:
        """Board number of the sync master."""
        return 1 + [beacon.sync_master for beacon in self.beacons].index(True)

    def parameter_page(self, board: int) -> bytes:
        """Build a board's parameter page (``framing.md``)."""
        own = self._sensor_parameters() if board == 0 else _beacon_parameters(self.beacons[board - 1], self.slots)
        if board > 0 and self.sync == "can":
            own = {**own, "sync_source": 2}
        return build_page(own if self.degree == DEGREE else {**own, "degree": self.degree})

    def _sensor_parameters(self) -> Mapping[str, Value]:
        zero, matrix = self.sensor.correction()
        codes = [beacon.code for beacon in self.beacons if beacon.code is not None]
        half = self.half_space
        surroundings: dict[str, Value] = {
            "pose": 1,
            "noise": max(self.sensor.noise_T, LEAST_NOISE_T),
            "half_space": [0.0] * 6 if half is None else [*half.point.tolist(), *half.normal.tolist()],
            "beacons": [value for beacon in self.beacons for value in _beacon_row(beacon)],
        }
        return (surroundings if self.sensor.pose else {}) | {
            "node": self.sensor.node,
            "stream": self.sensor.stream,
            "sync_source": 1 if not self.sensor.sync_wire else 2 if self.sync == "can" else 0,
            "code_count": len(codes),
            "code_list": codes,
            "zero_x": float(zero[0]),
            "zero_y": float(zero[1]),
            "zero_z": float(zero[2]),
            "calibration": [float(value) for value in matrix.ravel()],
        }

    def site_toml(self) -> str:
        """Write the host's site file for this scenario."""
        lines = [
            "[site]",
            f"name = {_toml(self.name)}",
            f"chip_period_s = {CHIP_PERIOD_S!r}",
            f"degree = {self.degree}",
        ]
        lines += {
            "cdma": [],
            "tdma": ['access = "tdma"', f"slots = {self.slots}"],
            "fdma, square": ['access = "fdma"', 'tone = "square"'],
            "fdma, sine": ['access = "fdma"', 'tone = "sine"'],
        }[self.beacons[0].access]
        if self.half_space is not None:
            point, normal = _toml(self.half_space.point), _toml(self.half_space.normal)
            lines.append(f"half_space = {{ point = {point}, normal = {normal} }}")
        lines += ["", "[sensor]", f"noise_T = {self.sensor.noise_T!r}"]
        for beacon in self.beacons:
            lines += self._site_beacon(beacon)
        return "\n".join(lines) + "\n"

    def _site_beacon(self, beacon: Beacon) -> list[str]:
        """Return the tables of a beacon: one, or one for each of its two coils."""
        drive = [f"code = {beacon.code}"]
        if beacon.codes:
            drive = [f"codes = [{', '.join(map(_code_toml, beacon.codes))}]"]
        elif beacon.slot is not None:
            drive = [f"slot = {beacon.slot}"]
        elif beacon.periods is not None:
            drive = [self._frequency(beacon.periods)]
        elif beacon.rotating_periods is not None and beacon.second_coil is not None:
            frequency = self._frequency(beacon.rotating_periods)
            cosine = _site_coil(f"{beacon.id}.cos", beacon, beacon.geometry)
            sine = _site_coil(f"{beacon.id}.sin", beacon, beacon.second_coil)
            return [*cosine, frequency, *sine, frequency, 'wave = "sine"']
        return [*_site_coil(beacon.id, beacon, beacon.geometry), *drive]

    def _frequency(self, periods: int) -> str:
        return f"frequency_Hz = {periods / (self.chips * CHIP_PERIOD_S)!r}"


def _site_coil(name: str, beacon: Beacon, coil: CoilGeometry) -> list[str]:
    lines = ["", "[[beacon]]", f"id = {_toml(name)}", f"position_m = {_toml(coil.position_m)}"]
    lines += [f"axis = {_toml(coil.axis)}", f"turns = {_toml(coil.turns)}"]
    if coil.points_m is None:
        lines.append(f"radius_m = {_toml(coil.radius_m)}")
    else:
        lines.append(f"points_m = {_toml(coil.points_m)}")
    return [*lines, f"current_A = {_toml(beacon.circuit.current_A)}"]


def _code_toml(code: Code) -> str:
    return f"{{ code = {code.index}, degree = {code.degree}, offset = {code.offset}, hold = {code.hold} }}"


def _beacon_row(beacon: Beacon) -> tuple[float, ...]:
    """Position, axis, moment and radius as the sensor's parameters have them; a wire becomes the circle of its area."""
    coil = beacon.geometry
    if coil.points_m is None:
        assert coil.radius_m is not None
        area, centre = math.pi * coil.radius_m**2, coil.position_m
    else:
        ends = np.roll(coil.points_m, -1, axis=0)
        area = float(np.linalg.norm(0.5 * np.cross(coil.points_m, ends).sum(axis=0)))
        lengths = np.linalg.norm(ends - coil.points_m, axis=1)
        centre = np.average(0.5 * (coil.points_m + ends), axis=0, weights=lengths)
    moment = coil.turns * area * beacon.circuit.current_A
    return (*map(float, centre), *map(float, coil.axis), moment, math.sqrt(area / math.pi))


def _beacon_parameters(beacon: Beacon, slots: int) -> Mapping[str, Value]:
    waveform: dict[str, Value] = {}
    if beacon.slot is not None:
        waveform = {"waveform": 1, "slots": slots, "slot": beacon.slot}
    elif beacon.periods is not None:
        waveform = {"waveform": 2, "periods": beacon.periods}
    elif beacon.rotating_periods is not None:
        waveform = {"waveform": 3, "periods": beacon.rotating_periods}
    elif beacon.codes:
        rows = [value for code in beacon.codes for value in (code.degree, code.index, code.offset, code.hold)]
        waveform = {"waveform": 4, "codes": rows}
    if beacon.code is not None:
        waveform["code"] = beacon.code
    return waveform | {
        "node": beacon.node,
        "amplitude": beacon.circuit.current_A,
        "sync_master": int(beacon.sync_master),
    }


def _toml(value: Any) -> str:
    if isinstance(value, str):
        return '"' + value.replace("\\", "\\\\").replace('"', '\\"') + '"'
    if isinstance(value, np.ndarray):
        return "[" + ", ".join(_toml(item) for item in value) + "]"
    return repr(float(value))


def find(name: str) -> Path:
    """Return the file of a scenario given by its name in ``scenarios`` or by a path.

    Raises
    ------
    UserError
        If there is none.
    """
    if Path(name).suffix == ".toml" or Path(name).is_file():
        return Path(name)
    path = SCENARIOS / f"{name}.toml"
    if not path.is_file():
        known = ", ".join(sorted(file.stem for file in SCENARIOS.glob("*.toml")))
        raise UserError(f"there is no scenario '{name}'; there are {known}; or give the path of a .toml file")
    return path


def load_scenario(name: str) -> Scenario:
    """Read the scenario of a name or a path; see `find` and `load`."""
    return load(find(name))


def load(path: str | Path) -> Scenario:
    """Read and check a scenario file.

    Raises
    ------
    UserError
        One sentence with file, line, table and key, if anything is missing, unknown, of the wrong type or out of range.
    """
    path = Path(path)
    lines = text_lines(path, "scenario")
    try:
        document = tomllib.loads("\n".join(lines))
    except tomllib.TOMLDecodeError as error:
        raise UserError(f"{path}: is no valid TOML: {error}") from error
    root = Table(document, path=path, lines=lines)
    root.allow(
        *("name", "seed", "degree", "power_on_spread_s", "slots", "sync", "half_space", "ambient", "sensor", "motion"),
        "coil",
        "beacon",
    )
    sync = root.text("sync") if "sync" in root else "wire"
    if sync not in ("wire", "can"):
        raise root.error("sync", f'is "{sync}"; it must be "wire" or "can"')
    defaults = root.table("coil") if "coil" in root else Table({}, path=path, lines=lines)
    defaults.allow(*COIL_KEYS)
    seed = root.integer("seed")
    if not 0 <= seed < 1 << 63:
        raise root.error("seed", "must lie in 0 to 2^63 - 1")
    degree = root.integer("degree") if "degree" in root else DEGREE
    if degree not in DEGREES:
        raise root.error("degree", f"is {degree}; codes exist for {', '.join(map(str, DEGREES))}")
    plan = Plan("cdma", degree, CHIP_PERIOD_S)
    scenario = Scenario(
        name=root.text("name"),
        seed=seed,
        power_on_spread_s=_not_negative(root, "power_on_spread_s", 0.02),
        half_space=_half_space(root.table("half_space")) if "half_space" in root else None,
        ambient=_ambient(root.table("ambient")) if "ambient" in root else Ambient(ZERO, None, Impulses()),
        sensor=_sensor(root.table("sensor")),
        motion=_motion(root.table("motion")),
        beacons=tuple(_beacon(table, defaults, plan) for table in root.tables("beacon")),
        slots=_between(root, "slots", 1, plan.chips) if "slots" in root else 0,
        degree=degree,
        sync=sync,
    )
    _check_boards(root, scenario)
    return scenario


# ---- Tables ----

CLOCK_KEYS = tuple(field.name for field in fields(Clock))
CIRCUIT_KEYS = tuple(field.name for field in fields(Circuit))
COIL_KEYS = (*CIRCUIT_KEYS, "turns", "radius_m", "axis")
CIRCUIT_REQUIRED = ("current_A", "inductance_H", "resistance_Ohm", "supply_V")
SENSOR_KEYS = (
    *("node", "noise_T", "converter_noise_LSB", "bandwidth_Hz", "range_T", "gain_error", "misalignment_rad"),
    *("offset_T", "calibration", "stream", "pose", "sync_wire", *CLOCK_KEYS),
)
MOTION_KEYS = {
    "still": ("position_m", "rotation_vector_rad"),
    "line": ("position_m", "rotation_vector_rad", "velocity_m_per_s", "rate_rad_per_s"),
    "waypoints": ("times_s", "positions_m", "rotation_vectors_rad"),
}
BEACON_KEYS = (
    *("id", "node", "code", "codes", "slot", "periods", "rotating_periods", "second_axis"),
    *("sync_master", "position_m", "points_m", *COIL_KEYS, *CLOCK_KEYS),
)


def _number(table: Table, key: str, default: float) -> float:
    return table.number(key) if key in table else default


def _vector(table: Table, key: str) -> FloatArray:
    return table.vector(key) if key in table else ZERO


def _not_negative(table: Table, key: str, default: float) -> float:
    value = _number(table, key, default)
    if value < 0.0:
        raise table.error(key, f"is {value:g}; it must not be negative")
    return value


def _between(table: Table, key: str, low: int, high: int) -> int:
    value = table.integer(key)
    if not low <= value <= high:
        raise table.error(key, f"is {value}; it must lie in {low} to {high}")
    return value


def _clock(table: Table) -> Clock:
    internal = _number(table, "internal_ppm", 0.0)
    crystal = _number(table, "crystal_ppm", 0.0)
    for key, value, limit in (("crystal_ppm", crystal, 5e3), ("internal_ppm", internal, 5e4)):
        if abs(value) > limit:
            raise table.error(key, f"is {value:g}; it must lie within +-{limit:g}")
    return Clock(
        crystal_ppm=crystal,
        internal_ppm=internal,
        crystal_dead="crystal_dead" in table and table.flag("crystal_dead"),
        temperature_degC=_number(table, "temperature_degC", 25.0),
    )


def _half_space(table: Table) -> HalfSpace:
    table.allow("point", "normal")
    return HalfSpace(point=table.vector("point"), normal=table.direction("normal"))


def _ambient(table: Table) -> Ambient:
    table.allow("earth_T", "mains", "impulses")
    mains, impulses = None, Impulses()
    if "mains" in table:
        inner = table.table("mains")
        inner.allow("frequency_Hz", "amplitude_T", "harmonics", "phase_rad")
        harmonics = tuple(inner.numbers("harmonics").tolist()) if "harmonics" in inner else (1.0,)
        if len(harmonics) > HARMONICS:
            raise inner.error("harmonics", f"lists {len(harmonics)}; at most {HARMONICS} are possible")
        mains = Mains(
            frequency_Hz=inner.positive("frequency_Hz"),
            amplitude_T=inner.vector("amplitude_T"),
            harmonics=harmonics,
            phase_rad=_number(inner, "phase_rad", 0.0),
        )
    if "impulses" in table:
        inner = table.table("impulses")
        inner.allow("rate_Hz", "amplitude_T", "decay_s")
        impulses = Impulses(
            rate_Hz=_not_negative(inner, "rate_Hz", 0.0),
            amplitude_T=inner.number("amplitude_T"),
            decay_s=inner.positive("decay_s") if "decay_s" in inner else Impulses.decay_s,
        )
    return Ambient(earth_T=_vector(table, "earth_T"), mains=mains, impulses=impulses)


def _sensor(table: Table) -> Sensor:
    table.allow(*SENSOR_KEYS)
    calibration = table.text("calibration") if "calibration" in table else "exact"
    if calibration not in ("exact", "nominal"):
        raise table.error("calibration", f'is "{calibration}"; it must be "exact" or "nominal"')
    return Sensor(
        node=_between(table, "node", 1, 4095),
        clock=_clock(table),
        noise_T=_not_negative(table, "noise_T", 0.0),
        converter_noise_LSB=_not_negative(table, "converter_noise_LSB", 0.5),
        bandwidth_Hz=_not_negative(table, "bandwidth_Hz", 0.0),
        range_T=table.positive("range_T"),
        gain_error=_vector(table, "gain_error"),
        misalignment_rad=_vector(table, "misalignment_rad"),
        offset_T=_vector(table, "offset_T"),
        calibration=calibration,
        stream=_between(table, "stream", 0, 1) if "stream" in table else 0,
        sync_wire=table.flag("sync_wire") if "sync_wire" in table else True,
        pose=_between(table, "pose", 0, 1) if "pose" in table else 1,
    )


def _motion(table: Table) -> Motion:
    kind = table.text("kind")
    if kind not in MOTION_KEYS:
        raise table.error("kind", f'is "{kind}"; it must be one of {", ".join(MOTION_KEYS)}')
    table.allow("kind", *MOTION_KEYS[kind])
    if kind == "waypoints":
        times = table.numbers("times_s")
        positions, rotations = table.vectors("positions_m"), table.vectors("rotation_vectors_rad")
        if len(times) < 2 or np.any(np.diff(times) <= 0.0):
            raise table.error("times_s", "must be at least two times that increase")
        for key, value in (("positions_m", positions), ("rotation_vectors_rad", rotations)):
            if len(value) != len(times):
                raise table.error(key, f"has {len(value)} entries; times_s has {len(times)}: give one each")
        return Waypoints(times, positions, rotations)
    position, rotation = table.vector("position_m"), _vector(table, "rotation_vector_rad")
    if kind == "still":
        return Still(position, rotation)
    return Line(position, rotation, _vector(table, "velocity_m_per_s"), _vector(table, "rate_rad_per_s"))


def _beacon(table: Table, defaults: Table, plan: Plan) -> Beacon:
    table.allow(*BEACON_KEYS)

    def source(key: str) -> Table:
        return defaults if key not in table and key in defaults else table

    values = {key: source(key).number(key) for key in CIRCUIT_KEYS if key in source(key) or key in CIRCUIT_REQUIRED}
    for key in ("inductance_H", "resistance_Ohm", "supply_V"):
        if values[key] <= 0.0:
            raise source(key).error(key, f"is {values[key]:g}; it must be greater than zero")
    if not 0.0 <= values["current_A"] <= 15.9:
        raise source("current_A").error("current_A", f"is {values['current_A']:g}; the boards drive 0 to 15.9 A")
    given = [key for key in ("codes", "slot", "periods", "rotating_periods") if key in table]
    if not given and "code" not in table:
        raise table.error("code", "is missing; give one, or codes, slot, periods or rotating_periods")
    if len(given) > 1:
        raise table.error(given[0], f"and {given[1]} are both given: a beacon drives one of them")
    geometry = _geometry(table, source)
    highest = (plan.chips - 1) // 2
    return Beacon(
        id=table.text("id"),
        node=_between(table, "node", 1, 4095),
        code=_between(table, "code", 0, 1 << plan.degree) if "code" in table else None,
        sync_master="sync_master" in table and table.flag("sync_master"),
        clock=_clock(table),
        circuit=Circuit(**values),
        geometry=geometry,
        slot=_between(table, "slot", 0, plan.chips - 1) if "slot" in table else None,
        periods=_between(table, "periods", 1, highest) if "periods" in table else None,
        rotating_periods=_between(table, "rotating_periods", 1, highest) if "rotating_periods" in table else None,
        second_coil=_second_coil(table, geometry),
        codes=_codes(table, plan) if "codes" in table else (),
    )


def _codes(table: Table, plan: Plan) -> tuple[Code, ...]:
    codes = read_drive(table, plan)[1].codes
    if len(codes) > CODES_MAX:
        raise table.error("codes", f"lists {len(codes)} codes; a board superposes at most {CODES_MAX}")
    for code in codes:
        lasts = code.hold * ((1 << code.degree) - 1)
        if plan.chips % lasts:
            raise table.error("codes", f"has a code that lasts {lasts} chips: a cycle of {plan.chips} is no multiple")
    return codes


def _second_coil(table: Table, first: CoilGeometry) -> CoilGeometry | None:
    """Return the sine coil of a dual-axis beacon: the same as the first around another axis."""
    if ("second_axis" in table) != ("rotating_periods" in table):
        raise table.error("second_axis", "and rotating_periods belong together: give both or none")
    if "second_axis" not in table:
        return None
    axis = table.direction("second_axis")
    if first.points_m is not None:
        raise table.error("points_m", "gives one coil, and second_axis needs two circular ones: give radius_m")
    if abs(float(axis @ first.axis)) > SQUARE_TOLERANCE:
        raise table.error("second_axis", "is not at right angles to axis: the two coils would couple")
    return replace(first, axis=axis)


def _geometry(table: Table, source: Callable[[str], Table]) -> CoilGeometry:
    if "points_m" in table:
        if "radius_m" in table:
            raise table.error("points_m", "and radius_m are both given: give one of them")
        points = table.vectors("points_m")
        area = 0.5 * np.cross(points, np.roll(points, -1, axis=0)).sum(axis=0)
        if len(points) < 3 or not np.any(area):
            raise table.error("points_m", "encloses no area: give at least three points that are not on a line")
        return CoilGeometry(
            turns=table.positive("turns") if "turns" in table else 1.0,
            radius_m=None,
            position_m=table.vector("position_m") if "position_m" in table else points.mean(axis=0),
            axis=area / np.linalg.norm(area),
            points_m=points,
        )
    return CoilGeometry(
        turns=source("turns").positive("turns"),
        radius_m=source("radius_m").positive("radius_m"),
        position_m=table.vector("position_m"),
        axis=source("axis").direction("axis"),
    )


def _check_boards(root: Table, scenario: Scenario) -> None:
    tables = root.tables("beacon")
    masters = [beacon.id for beacon in scenario.beacons if beacon.sync_master]
    if len(masters) != 1:
        found = f"{', '.join(masters)} have" if masters else "none has"
        raise root.error("beacon", f"tables: exactly one must have sync_master = true; {found}")
    taken: dict[tuple[str, Any], str] = {("node", scenario.sensor.node): "the sensor"}
    for table, beacon in zip(tables, scenario.beacons, strict=True):
        if beacon.slot is not None and beacon.slot >= scenario.slots:
            raise table.error("slot", f"is {beacon.slot}; it must be below the scenario's slots ({scenario.slots})")
        if beacon.access != scenario.beacons[0].access:
            raise table.error(
                "id", "is driven otherwise than the first beacon: all need codes, or slots, or periods, or turn"
            )
        for key in ("id", "node", "code"):
            value = getattr(beacon, key)
            if value is None:
                continue
            if (key, value) in taken:
                raise table.error(key, f"is {value!r}, which {taken[key, value]} already has: take another")
            taken[key, value] = f"beacon {beacon.id}"
    if scenario.sensor.pose and any(beacon.plain_code is None for beacon in scenario.beacons):
        raise root.table("sensor").error("pose", "is 1, but the board can tell apart plain codes alone: set pose = 0")
    try:
        for board in range(len(scenario.beacons) + 1):
            scenario.parameter_page(board)
    except ParameterError as error:
        raise root.error(
            "sensor" if board == 0 else "beacon", f"does not fit the boards' parameters: {error}"
        ) from error
