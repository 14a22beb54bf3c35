"""The drive of a beacon: the keys of a site file that say how beacons are told apart, and how fast a coil follows."""

from __future__ import annotations

from dataclasses import dataclass

from goldfield.files.toml_table import Table

ACCESS = ("cdma", "tdma", "fdma")
SITE_KEYS = {"slots": "tdma", "tone": "fdma", "phase": "fdma", "samples": "fdma"}
"""Keys of the site and the access they belong to."""

TONES = ("sine", "square")

PHASES = ("known", "unknown")

SAMPLES = (8, 200_000)
"""Least and most samples in a window of tones with unknown phases; more than these take gigabytes."""

WAVES = ("cosine", "sine")
"""Phases of an alternating current: two coils at one place, one with each, make a rotating field."""

NO_CODE = -1
"""Code index of a beacon without exactly one plain Gold code of the site's degree; no generator takes it."""

DEGREES = (5, 6, 7, 9, 10, 11)
"""Degrees with a preferred pair of m-sequences (maths.md, 1: other degrees have none or are not used)."""

WHOLE_TOLERANCE = 0.01
"""Largest distance of a cycle's periods from a whole number: about this part of a field leaks into a neighbour's."""

LONGEST_TAU_CHIPS = 10.0
"""Longest accepted time constant of a coil: one that settles more slowly follows none of its chips."""


@dataclass(frozen=True)
class Code:
    """A Gold code on a beacon.

    Attributes
    ----------
    index, degree : int
        Index and degree of the code.
    offset : int
        Number of its own chips by which the code runs ahead.
    hold : int
        Chips of the site for which one chip of this code lasts: its chip rate is so many times slower.
    """

    index: int
    degree: int
    offset: int = 0
    hold: int = 1


@dataclass(frozen=True)
class Drive:
    """Everything that distinguishes a beacon beside its one plain code; an empty drive distinguishes nothing.

    Attributes
    ----------
    codes : tuple of Code
        Codes driven at once, each with an equal part of the current: the beacon's current is their peak.
    slot : int or None
        Time slot of pulsed direct current (TDMA).
    periods : int or None
        Whole periods of an alternating current in a cycle (FDMA): cos(2 pi periods t / N) in chip t, or its sine.
    wave : str
        Phase of the alternating current, one of `WAVES`.
    square : bool
        True drives the sign of the cosine in its place, as a bridge without planned set-points does.
    tau_s : float
        Time constant with which the current of the coil follows a step; with 0 it follows at once.
    frequency_Hz : float or None
        Frequency of a tone of unknown phase (FDMA), which need not have whole periods in a cycle.
    phase_rad : float
        Which of two opposite phases is meant: the one nearer to this (`goldfield.access.tones`).
    """

    codes: tuple[Code, ...] = ()
    slot: int | None = None
    periods: int | None = None
    wave: str = "cosine"
    square: bool = False
    tau_s: float = 0.0
    frequency_Hz: float | None = None
    phase_rad: float = 0.0


NOTHING_ELSE = Drive()


@dataclass(frozen=True)
class Plan:
    """The part of the drives that all beacons of a site have in common.

    Attributes
    ----------
    access : str
        One of `ACCESS`.
    degree : int
    chip_period_s : float
    slots : int
        Number of time slots of a cycle (TDMA), else 0.
    square : bool
        True if tones are square waves (FDMA).
    free : bool
        True if tones have any frequency and an unknown phase (FDMA).
    samples : int
        Samples of a window, for these tones, in place of a degree; else 0.
    """

    access: str
    degree: int
    chip_period_s: float
    slots: int = 0
    square: bool = False
    free: bool = False
    samples: int = 0

    @property
    def chips(self) -> int:
        """Chips in a cycle, N, or samples in a window."""
        return self.samples or (1 << self.degree) - 1


def read_plan(site: Table) -> Plan:
    """Read ``degree, chip_period_s``, optionally ``access``, for TDMA ``slots``, for FDMA ``tone, phase, samples``.

    Raises
    ------
    UserError
        If any value is missing or out of range.
    """
    samples = _samples(site) if "samples" in site else 0
    degree = 0 if samples else _degree(site)
    access = site.text("access") if "access" in site else "cdma"
    if access not in ACCESS:
        raise site.error("access", f'is "{access}"; beacons are told apart by {", ".join(ACCESS)}')
    for key, owner in SITE_KEYS.items():
        if key in site and access != owner:
            raise site.error(key, f'belongs to access = "{owner}", but the access here is "{access}": leave it out')
    phase = site.text("phase") if "phase" in site else "known"
    if phase not in PHASES:
        raise site.error("phase", f'is "{phase}"; phases are {" or ".join(PHASES)}')
    if samples and phase == "known":
        raise site.error("samples", 'is for tones with phase = "unknown": give the degree in its place')
    chip_period_s = site.positive("chip_period_s")
    if access != "tdma":
        tone = site.text("tone") if "tone" in site else "sine"
        if tone not in TONES:
            raise site.error("tone", f'is "{tone}"; tones are {" or ".join(TONES)}')
        if tone == "square" and phase == "unknown":
            raise site.error("tone", 'is "square", but only sines have one phase: leave out phase')
        return Plan(access, degree, chip_period_s, square=tone == "square", free=phase == "unknown", samples=samples)
    slots, chips = site.integer("slots"), (1 << degree) - 1
    if not 1 <= slots <= chips:
        raise site.error("slots", f"is {slots}; a cycle of {chips} chips has 1 to {chips} slots")
    return Plan(access, degree, chip_period_s, slots)


def _degree(site: Table) -> int:
    degree = site.integer("degree")
    if degree not in DEGREES:
        raise site.error("degree", f"is {degree}; Gold codes exist here for {', '.join(map(str, DEGREES))}")
    return degree


def _samples(site: Table) -> int:
    samples, (least, most) = site.integer("samples"), SAMPLES
    if "degree" in site:
        raise site.error("samples", "and degree are both given: a window has so many samples, leave out degree")
    if not least <= samples <= most:
        raise site.error("samples", f"is {samples}; a window has {least} to {most} samples")
    return samples


BEACON_KEYS = {
    "code": "cdma",
    "codes": "cdma",
    "slot": "tdma",
    "frequency_Hz": "fdma",
    "wave": "fdma",
    "phase_rad": "fdma",
}
"""Keys of a beacon and the access they belong to."""


def read_drive(table: Table, plan: Plan) -> tuple[int, Drive]:
    """Read what a beacon drives: its plain code, or `NO_CODE`, and all the rest.

    Raises
    ------
    UserError
        If any value is missing, out of range or belongs to another access.
    """
    for key, access in BEACON_KEYS.items():
        if key in table and access != plan.access:
            raise table.error(key, f'belongs to access = "{access}", but the site\'s access is "{plan.access}"')
    tau_s = table.number("tau_s") if "tau_s" in table else 0.0
    longest = LONGEST_TAU_CHIPS * plan.chip_period_s
    if not 0.0 <= tau_s <= longest:
        raise table.error("tau_s", f"is {tau_s:g}; a coil's time constant is 0 to {longest:g} s (ten chips)")
    if plan.access == "tdma":
        slot = table.integer("slot")
        if not 0 <= slot < plan.slots:
            raise table.error("slot", f"is {slot}; the site has the slots 0 to {plan.slots - 1}")
        return NO_CODE, Drive(slot=slot, tau_s=tau_s)
    if plan.free:
        return NO_CODE, _free_tone(table, plan)
    if "phase_rad" in table:
        raise table.error(
            "phase_rad", 'is for tones of unknown phase: leave it out, or write phase = "unknown" in [site]'
        )
    if plan.access == "fdma":
        return NO_CODE, Drive(periods=_periods(table, plan), wave=_wave(table, plan), square=plan.square, tau_s=tau_s)
    if "codes" in table:
        if "code" in table:
            raise table.error("codes", "and code are both given: give one of them")
        return NO_CODE, Drive(codes=tuple(_code(part, plan) for part in table.tables("codes")), tau_s=tau_s)
    return _index(table, plan.degree), Drive(tau_s=tau_s)


def _index(table: Table, degree: int) -> int:
    code = table.integer("code")
    if not 0 <= code <= 1 << degree:
        raise table.error("code", f"is {code}; codes of degree {degree} are 0 to {1 << degree}")
    return code


def _code(table: Table, plan: Plan) -> Code:
    table.allow("code", "degree", "offset", "hold")
    degree = table.integer("degree") if "degree" in table else plan.degree
    if degree not in DEGREES:
        raise table.error("degree", f"is {degree}; Gold codes exist here for {', '.join(map(str, DEGREES))}")
    hold = table.integer("hold") if "hold" in table else 1
    length = (1 << degree) - 1
    if hold < 1 or hold * length > plan.chips:
        key = "hold" if hold < 1 or "hold" in table else "degree"
        raise table.error(
            key,
            f"makes the code last {hold} times {length} chips; it must last 1 to {plan.chips}, a cycle of the site",
        )
    offset = table.integer("offset") if "offset" in table else 0
    if not 0 <= offset < length:
        raise table.error("offset", f"is {offset}; offsets of a code of degree {degree} are 0 to {length - 1} chips")
    return Code(_index(table, degree), degree, offset, hold)


def _periods(table: Table, plan: Plan) -> int:
    frequency = table.positive("frequency_Hz")
    cycle_s = plan.chips * plan.chip_period_s
    highest = (plan.chips - 1) // 2
    periods = min(max(round(frequency * cycle_s), 1), highest)
    if abs(frequency * cycle_s - periods) > WHOLE_TOLERANCE:
        raise table.error(
            "frequency_Hz",
            f"is {frequency:g}, {frequency * cycle_s:.4g} periods a cycle; give whole periods, 1 to {highest}, "
            f"such as {periods / cycle_s:.6g} Hz",
        )
    return periods


def _free_tone(table: Table, plan: Plan) -> Drive:
    for key in ("wave", "tau_s"):
        if key in table:
            raise table.error(key, "is of no use for a tone of unknown phase: leave it out")
    frequency, half = table.positive("frequency_Hz"), 0.5 / plan.chip_period_s
    if frequency >= half:
        raise table.error("frequency_Hz", f"is {frequency:g}; it is below {half:g} Hz, half the rate of the samples")
    return Drive(frequency_Hz=frequency, phase_rad=table.number("phase_rad") if "phase_rad" in table else 0.0)


def _wave(table: Table, plan: Plan) -> str:
    wave = table.text("wave") if "wave" in table else "cosine"
    if wave not in WAVES:
        raise table.error("wave", f'is "{wave}"; waves are {" or ".join(WAVES)}')
    if plan.square and wave != "cosine":
        raise table.error("wave", 'is "sine", but square tones are the sign of a cosine: take tone = "sine" of [site]')
    return wave
