"""The parts of a scenario: boards, coils and surroundings, in SI units."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from goldfield.site.drive import Code
from goldfield_protocol.rates import CAN_RATES, SERIAL_RATES
from hil_sim.world.motion import Still
from hil_sim.world.path import CoilGeometry

FloatArray = NDArray[np.float64]

CHIP_TICKS, TICKS_PER_SECOND = 16422, 168e6
CHIP_PERIOD_S = CHIP_TICKS / TICKS_PER_SECOND
DEGREE = 10
"""Degree of the codes unless the scenario says otherwise: the boards' default."""
CONVERTER_COUNTS = 4096
BURST = 8
"""Conversions of an axis in a chip (``hal.h``)."""


PROCESSOR_SUPPLY_V = 3.3
"""Nominal supply of a board's processor."""


@dataclass(frozen=True)
class CanBus:
    """What a CAN bus does to frames.

    Attributes
    ----------
    bit_error_probability : float
        Each bit on the bus is wrong with this probability.
    delay_s : float
        Receivers have each frame later by so much: transceivers and cable.
    """

    bit_error_probability: float = 0.0
    delay_s: float = 0.0


@dataclass(frozen=True)
class Links:
    """The bit rates of a bench: the boards' parameters, its CAN bus and its serial lines.

    Attributes
    ----------
    can_bit_s, serial_baud : int
        Members of `goldfield_protocol.rates`.
    """

    can_bit_s: int = CAN_RATES[0]
    serial_baud: int = SERIAL_RATES[0]


FASTEST = Links()
"""The boards' rates unless they are told others."""
CLEAN_BUS = CanBus()
"""A CAN bus that neither destroys nor delays."""


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
    source_Ohm : float
        Resistance of the supply; it takes back what the coil gives.
    reference_offset_A, asymmetry, dc_error_A : float
        What the driver adds to the magnitude that it is asked for; by which share a positive current is larger and a
        negative one smaller; what it adds to the current while its bridge drives.
    dead_time_s, driver_delay_s, driver_limit_A : float
        Time for which the bridge is off after a change; lateness of its loop; its own limit, 0: none.
    ambient_degC, thermal_resistance_K_per_W, heat_capacity_J_per_K : float
        Surroundings of the coil, whose resistance is that at 20 degC; thermal resistance 0: it stays at the ambient's.
    shorted_fraction : float
        Share of the turns that the fault ``coil_shorted`` shorts.
    shorted_coupling : float
        Coupling of these turns to the rest: 1 is a transformer without leakage.
    """

    current_A: float
    inductance_H: float
    resistance_Ohm: float
    supply_V: float
    reference_gain_error: float = 0.0
    sense_gain_error: float = 0.0
    sense_noise_A: float = 0.005
    source_Ohm: float = 0.0
    reference_offset_A: float = 0.0
    asymmetry: float = 0.0
    dc_error_A: float = 0.0
    dead_time_s: float = 0.0
    driver_delay_s: float = 0.0
    driver_limit_A: float = 0.0
    ambient_degC: float = 20.0
    thermal_resistance_K_per_W: float = 0.0
    heat_capacity_J_per_K: float = 0.0
    shorted_fraction: float = 0.5
    shorted_coupling: float = 0.9


@dataclass(frozen=True)
class Clock:
    """A board's oscillators, processor and power.

    Attributes
    ----------
    crystal_ppm, internal_ppm : float
        Errors of crystal and internal oscillator.
    crystal_ppm_per_K, crystal_ppm_per_s : float
        What the crystal's error grows by with temperature and time, from virtual time 0 on (emulated boards).
    crystal_dead : bool
        The crystal never starts (emulated boards).
    crystal_stops_s : float
        Virtual time at which the crystal stops for good; infinite: it does not (emulated boards).
    temperature_degC, temperature_K_per_s : float
        Temperature of processor and crystal at virtual time 0, and how fast it rises (the rise: emulated boards).
    processor_supply_V : float
        Supply of the processor and reference of its converters (emulated boards).
    flash : str
        The file that keeps the processor's flash from one rig to the next; empty: none does (emulated boards).
    public_key : str
        The board has a boot loader that knows this public key, in hexadecimal digits, so that it takes images over its
        links; empty: the image starts alone (emulated boards).
    """

    crystal_ppm: float = 0.0
    internal_ppm: float = 0.0
    crystal_ppm_per_K: float = 0.0
    crystal_ppm_per_s: float = 0.0
    crystal_dead: bool = False
    crystal_stops_s: float = math.inf
    temperature_degC: float = 25.0
    temperature_K_per_s: float = 0.0
    processor_supply_V: float = PROCESSOR_SUPPLY_V
    flash: str = ""
    public_key: str = ""


@dataclass(frozen=True, eq=False)
class FrontEnd:
    """A magnetoresistive sensor and its amplifier.

    Attributes
    ----------
    noise_T : float
        Standard deviation of one chip's sample on one axis, without the converter's own.
    converter_noise_LSB : float
        Standard deviation of each single conversion, in steps of the converter.
    bandwidth_Hz : float
        First-order low-pass; 0: none.
    range_T : float
        Field at the converter's ends.
    gain_error : ndarray, shape (3,)
    misalignment_rad : ndarray, shape (3,)
        Leaning of the sensitive axes: x toward y, x toward z, y toward z.
    offset_T : ndarray, shape (3,)
    calibration : str
        ``exact``: the parameter page holds the true zero and matrix; ``nominal``: those of a perfect sensor.
    """

    noise_T: float
    converter_noise_LSB: float
    bandwidth_Hz: float
    range_T: float
    gain_error: FloatArray
    misalignment_rad: FloatArray
    offset_T: FloatArray
    calibration: str

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

    @property
    def sample_noise_T(self) -> float:
        """Standard deviation of a chip's sample, to three digits: its noise and the converter's, averaged.

        The steps count as a noise of LSB / sqrt(12) in each conversion, as they are where the noise spans them.
        """
        step_T = 2.0 * self.range_T / CONVERTER_COUNTS
        converter_T = step_T * math.sqrt((self.converter_noise_LSB**2 + 1.0 / 12.0) / BURST)
        return float(f"{math.hypot(self.noise_T, converter_T):.3g}")

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
class Sensor(FrontEnd):
    """The sensor board.

    Attributes
    ----------
    stream : int
        The board's parameter: 0 fields, 1 fields and every raw chip.
    pose : int
        With 1 the board knows the beacons and computes its own poses, with 0 it knows nothing of them.
    sync_wire : bool
        True: it follows the sync wire; False: its sync input is not connected, it follows the beacons' field, or, if
        the boards choose, CAN or the field.
    """

    node: int
    clock: Clock
    stream: int
    pose: int
    sync_wire: bool = True


@dataclass(frozen=True, eq=False)
class Anchor(FrontEnd):
    """A beacon's own sensor, at rest; ``rotation_vector_rad`` turns from its frame to the site's."""

    position_m: FloatArray
    rotation_vector_rad: FloatArray

    @property
    def motion(self) -> Still:
        """Its place."""
        return Still(self.position_m, self.rotation_vector_rad)


@dataclass(frozen=True, eq=False)
class Beacon:
    """One beacon board with its coil or coils.

    It drives its code unless it has superposed ``codes``, a time ``slot`` (pulsed direct current), ``periods`` in a
    cycle (square wave) or ``rotating_periods`` (a cosine in the coil, a sine in the ``second_coil`` that crosses it).
    With a ``sensor`` of its own it is an anchor.
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
    sensor: Anchor | None = None
    sync_rank: int = 0

    @property
    def coils(self) -> tuple[CoilGeometry, ...]:
        """Its coils in the order of the board's channels."""
        return (self.geometry,) if self.second_coil is None else (self.geometry, self.second_coil)

    def moved(self, by_m: FloatArray, sensor_stays: bool = False) -> Beacon:
        """Return the beacon at another place, its sensor with it unless that stays."""
        anchor = self.sensor
        if anchor is not None and not sensor_stays:
            anchor = replace(anchor, position_m=anchor.position_m + by_m)
        second = None if self.second_coil is None else self.second_coil.moved(by_m)
        return replace(self, geometry=self.geometry.moved(by_m), second_coil=second, sensor=anchor)

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

    @property
    def hum_T(self) -> float:
        """Root mean square over time and axes."""
        return float(np.linalg.norm(self.amplitude_T) * np.linalg.norm(self.harmonics) / math.sqrt(6.0))


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
class HalfSpace:
    """The side of a plane where the sensor is; for the site file."""

    point: FloatArray
    normal: FloatArray
