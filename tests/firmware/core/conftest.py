"""The core as a shared library, and Gold codes from an independent source (scipy.signal.max_len_seq)."""

from functools import cache

import numpy as np
import pytest
from scipy.signal import max_len_seq

from hil_sim import clib
from tests.firmware.gold_pairs import PAIRS

HEADERS = (
    "core/boot/image.h",
    "core/boot/select.h",
    "core/boot/install.h",
    "core/codes/gold.h",
    "core/codes/despread.h",
    "core/codes/epoch.h",
    "core/codes/strongest.h",
    "core/codes/code_bits.h",
    "core/codes/block_sums.h",
    "core/codes/separation.h",
    "core/timing/chip_clock.h",
    "core/timing/election.h",
    "core/drive/current.h",
    "core/drive/fall.h",
    "core/drive/latch.h",
    "core/drive/thermistor.h",
    "core/drive/waveform.h",
    "core/link/bus_share.h",
    "core/link/spread.h",
    "core/link/frame.h",
    "core/link/messages.h",
    "core/link/queue.h",
    "core/link/parameters.h",
    "core/link/parameter_set.h",
    "core/storage/crc32.h",
    "core/storage/store.h",
    "core/math/fourier.h",
    "core/math/normal3.h",
    "core/math/nuisance.h",
    "core/math/quaternion.h",
    "core/math/triangle.h",
    "core/pose/loop_field.h",
    "core/pose/wahba.h",
    "core/pose/pose.h",
    "core/pose/pose_covariance.h",
    "core/pose/pose_live.h",
    "core/pose/pose_mirror.h",
    "core/track/block_filter.h",
    "core/track/block_select.h",
    "core/track/block_out.h",
    "core/track/block_errors.h",
    "core/track/block_cycle.h",
)


def sequence(degree, exponents):
    """Bits of one period: s[t+n] is the sum of s[t+n-j] over the exponents j; starts with ones."""
    taps = [degree - j for j in exponents if j < degree]
    return max_len_seq(degree, state=np.ones(degree, np.int8), taps=taps)[0].astype(np.int8)


@cache
def family(degree):
    """Chips (+1, -1) of every code of a family, shape (N + 2, N)."""
    u, v = (sequence(degree, exponents) for exponents in PAIRS[degree])
    length = len(u)
    shifts = (np.arange(length)[:, None] + np.arange(length)) % length
    return 1 - 2 * np.concatenate([u ^ v[shifts], u[None], v[None]]).astype(np.int64)


@pytest.fixture(scope="session")
def gold_family():
    return family


@pytest.fixture(scope="session")
def core():
    """(ffi, library) of the core alone."""
    return clib.load("libgf_core.so", HEADERS)
