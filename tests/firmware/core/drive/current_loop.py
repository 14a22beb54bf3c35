"""A current loop around a simulated driver and coil, its reference used as a planner does: a block or two later."""

import math
from collections import deque

import numpy as np

SENSE, REFERENCE = 0.0078125, 0.00390625
OFF, RAMPING, HOLDING, FAULT = range(4)
AHEAD = 62  # Chips between the planning of a set-point and its measurement, at most.


def codes(chip):
    """Level of a chip: either sign, at random."""
    return 1.0 if chip * 7919 % 13 < 6 else -1.0


def sinusoid(periods):
    return lambda chip: math.sin(2.0 * math.pi * periods * chip / 2047)


def pulse(chip):
    return 1.0


def three_codes(chip):
    return (2.0 * two_codes(chip) + (1.0 if chip * 15485863 % 19 < 9 else -1.0)) / 3.0


def two_codes(chip):
    return 0.5 * (codes(chip) + (1.0 if chip * 104729 % 17 < 8 else -1.0))


OVER, OPEN, EXCESS, OVERLOAD = 1, 2, 5, 6


def configure(
    core, amplitude, over=12.0, open_fraction=0.5, sense=SENSE, reference=REFERENCE, rms=0.0, chips=1e5, sizes=False
):
    ffi, lib = core
    loop = ffi.new("current_t *")
    config = ffi.new("current_config_t *", [sense, reference, amplitude, open_fraction, sizes, [over, rms, chips]])
    return loop, lib.current_configure(loop, config)


class Drive:
    """A driver and its coil, set-points planned some chips ahead.

    ``gain`` may differ by direction, ``error_A`` adds to the magnitude and ``dc_A`` to the current.
    """

    def __init__(self, core, loop, gain=1.0, level=codes, ahead=AHEAD, offset=0.0, noise=0.5, seed=1, **errors):
        self.lib, self.loop = core[1], loop
        self.gain, self.level, self.offset, self.noise = gain, level, offset, noise
        self.negative_gain = errors.get("negative_gain")
        self.error_A, self.dc_A = errors.get("error_A", 0.0), errors.get("dc_A", 0.0)
        self.rng = np.random.default_rng(seed)
        self.planned = deque([0] * ahead)
        self.planned_chip, self.chip = ahead, 0
        for _ in range(257):
            assert not self.lib.current_ready(loop)
            assert self.lib.current_sample(loop, False, 0, self._count(0.0)) == 0
        assert self.lib.current_ready(loop)
        self.lib.current_start(loop)

    def _count(self, current):
        return int(np.clip(round(2048 + (current + self.offset) / SENSE + self.rng.normal(0, self.noise)), 0, 4095))

    def makes(self, level, set_point):
        """Current of a set-point: in the set-point's direction, in the level's where it is 0."""
        along = set_point or level
        gain = self.gain if along > 0.0 or self.negative_gain is None else self.negative_gain
        size = max(abs(set_point) * REFERENCE * gain + self.error_A, 0.0) if set_point else 0.0
        return math.copysign(size, along) + self.dc_A if level else 0.0

    def sample(self, current=None):
        """One chip, with the current that the coil makes or another one; returns whether the drive goes on."""
        self.planned.append(self.lib.current_set_point(self.loop, round(self.level(self.planned_chip) * 16384)))
        self.planned_chip += 1
        level = self.level(self.chip)
        self.chip += 1
        set_point = self.planned.popleft()
        self.current = self.makes(level, set_point) if current is None else current
        self.asked = set_point
        self.cause = self.lib.current_sample(self.loop, level != 0.0, set_point, self._count(self.current))
        return self.cause == 0

    def run(self, chips):
        """Reference after each chip, A; the drive must go on."""
        references = []
        for _ in range(chips):
            assert self.sample(), (self.chip, self.cause)
            references.append(self.loop.reference * REFERENCE)
        return np.array(references)

    def amplitude_and_dc(self, chips=4 * 2047):
        """The line through level and current by least squares over some chips, A: its slope and its intercept."""
        levels = np.array([self.level(chip) for chip in range(self.chip, self.chip + chips)])
        currents = []
        for _ in range(chips):
            assert self.sample(), (self.chip, self.cause)
            currents.append(self.current)
        driven = levels != 0.0
        return np.polyfit(levels[driven], np.array(currents)[driven], 1)


def running(core, **options):
    loop, _ = configure(core, 10.0, **options)
    Drive(core, loop, noise=0.0).run(1500)
    return loop
