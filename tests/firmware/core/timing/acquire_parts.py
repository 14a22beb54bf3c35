"""What the tests of acquire.c's calls share: a state to set, and records made here."""

from __future__ import annotations

import numpy as np

from hil_sim import clib

CHIPS, CHIP_TICKS, FIRST_HOLD, CONVERSION, LAG = 1023, 16422, 14672, 216, 267
TARGET, EXTRA, DETUNE, ONE = 286, 700, 48, 2**32
RECORDING, TRANSFORMING, AMPLITUDES, EDGE, MEASURING = range(5)
NONE, SWEEP, JUMP, CORRECT, AGAIN = range(5)
HALVES, TRACKING = 4, 7
CODES = [2, 3, 4, 5, 6, 7, 8, 9]
HEADERS = ("chip_clock", "acquire_record", "code_search", "code_field", "edge_fit", "edge_track", "acquire")


def load():
    headers = [f"core/timing/{name}.h" for name in HEADERS]
    return clib.load("libgf_core.so", (*headers[:2], "core/math/fourier.h", *headers[2:]))


def board(core):
    return core[0].new("acquire_config_t *", [CHIP_TICKS, FIRST_HOLD, CONVERSION, LAG])


def new(core, codes=None):
    ffi, lib = core
    acquire = ffi.new("acquire_t *")
    ffi.memmove(acquire, bytes([0x45]) * ffi.sizeof(acquire[0]), ffi.sizeof(acquire[0]))
    lib.acquire_init(acquire, board(core))
    if codes is not None:
        lib.acquire_codes(acquire, codes, len(codes))
    return acquire


def used(acquire):
    return list(acquire.codes[0 : acquire.code_count])


def state(core, of):
    return bytes(core[0].buffer(of))


def searched(core, acquire, label, height):
    """Put the search at its end, with a peak of this height at a label and the next."""
    acquire.stage, acquire.command, acquire.recorded = TRANSFORMING, NONE, 1
    acquire.code = acquire.code_count
    each = height * (CHIPS - 2) / (CHIPS - 2 * height)
    metric = np.ones(CHIPS)
    metric[[label, (label + 1) % CHIPS]] = each
    acquire.search.metric = metric.tolist()


def fill(core, acquire, family, codes, amplitudes, share, noise, rng, label=0):
    """Make a record that shows codes from a chip on, with a share of each change done in the late conversions."""
    ffi, _ = core
    record = np.frombuffer(ffi.buffer(ffi.addressof(acquire, "record")), dtype=np.int16).reshape(2, CHIPS, 3)
    shown = np.array([family[code] for code in codes]).T @ amplitudes
    change = np.roll(shown, -1, axis=0) - shown
    at = (label + np.arange(CHIPS)) % CHIPS
    record[0] = np.round(shown[at] + rng.normal(0.0, noise, (CHIPS, 3)))
    record[1] = np.round(np.reshape(share, (-1, 1)) * change[at] + rng.normal(0.0, noise, (CHIPS, 3)))


def amplitudes_of(rng, count):
    return rng.uniform(100.0, 400.0, (count, 3)) * rng.choice([-1.0, 1.0], (count, 3))
