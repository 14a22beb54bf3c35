"""Bits of codes and sums of blocks, against codes of another source and sums in double precision."""

import numpy as np
import pytest

CHIPS = 31
DEGREES = [5, 6, 7, 9, 10, 11]
MIXED = np.array([[1.0e-7, 2e-9, -3e-9], [1e-9, 0.9e-7, 4e-9], [-2e-9, 5e-9, 1.1e-7]])
ZERO = np.array([2040.5, 2050.25, 2047.0])


def words(codes):
    """Bits of chips (+1, -1) along the last axis."""
    return ((1 - codes) // 2 << np.arange(codes.shape[-1])).sum(axis=-1)


@pytest.mark.parametrize("degree", DEGREES)
def test_bits_of_every_code_from_every_chip(core, gold_family, degree):
    ffi, lib = core
    codes = gold_family(degree)
    length = codes.shape[1]
    bits = ffi.new("code_bits_t *")
    ffi.buffer(bits)[:] = b"\xa5" * ffi.sizeof("code_bits_t")  # As of another degree before.
    lib.code_bits_init(bits, lib.gold_family(degree))
    chips = np.arange(length) if length < 200 else np.random.default_rng(degree).integers(0, length, 20)
    for chip in [*chips, 0, length - 1, length - 31, length - 30, length, 3 * length + 5]:
        expected = words(np.take(codes, np.arange(chip, chip + CHIPS), axis=1, mode="wrap"))
        assert [lib.code_bits_at(bits, code, int(chip)) for code in range(length + 2)] == expected.tolist()


def collector_of(core, length):
    ffi, lib = core
    state = ffi.new("block_collector_t *")
    lib.block_collect_init(state, length)
    return state


@pytest.fixture
def collector(core):
    return collector_of(core, 1023)


def collect(core, state, chips, *, offset=0, saturated=0, locked=True):
    """Feed absolute chips; the code is ``offset`` chips ahead of them."""
    ffi, lib = core
    for absolute in chips:
        sample = ffi.new("int16_t[3]", [absolute % 1000, -absolute % 777, 5])
        cycle, code_chip = divmod(absolute + offset, state.length)
        lib.block_collect(state, absolute, cycle, code_chip, sample, saturated, locked)


def waiting(core, state):
    """The blocks that wait, each taken: number, cycle, chip and saturated axes."""
    _, lib = core
    found = []
    while state.filled != state.released:  # as block_ready, which is inline
        block = state.blocks[state.released % len(state.blocks)]
        first = block.number * CHIPS
        assert [list(s) for s in block.samples] == [[t % 1000, -t % 777, 5] for t in range(first, first + CHIPS)]
        found.append((block.number, block.cycle, block.chip, block.saturated))
        lib.block_release(state)
    return found


def test_blocks_run_into_the_next_cycle(core, collector):
    collect(core, collector, range(95, 34 * 31), offset=20)
    assert waiting(core, collector) == [
        (n, 0, 31 * n + 20, 0) for n in range(4, 4 + len(collector.blocks))
    ]  # main took none of the later ones
    collect(core, collector, range(34 * 31, 37 * 31), offset=20)
    assert waiting(core, collector) == [(n, 1, 31 * n + 20 - 1023, 0) for n in range(34, 37)]
    collect(core, collector, range(65 * 31, 66 * 31), offset=20)
    assert waiting(core, collector) == [(65, 1, 65 * 31 + 20 - 1023, 0)]  # it ends behind the cycle


@pytest.mark.parametrize("lost", [0, 1, 15, 30])
def test_a_block_with_a_chip_missing_or_unlocked_or_after_a_jump_is_left_out(core, collector, lost):
    for number, (missing, unlocked, jump) in enumerate([(True, False, 0), (False, True, 0), (False, False, 7)]):
        first = number * 4 * 31
        chips = range(first, first + 4 * 31)
        bad = first + 31 + lost
        collect(core, collector, range(first, bad))
        if not missing:
            collect(core, collector, [bad], locked=not unlocked, offset=jump)
        collect(core, collector, chips[chips.index(bad) + 1 :], offset=jump)
        expected = [4 * number, 4 * number + 2, 4 * number + 3]
        if jump and lost == 0:  # the jump is between two blocks: nothing is cut
            expected.insert(1, 4 * number + 1)
        assert [block[0] for block in waiting(core, collector)] == expected


@pytest.mark.parametrize(
    ("length", "gap"), [(31, 31), (31, 62), (63, 63), (63, 31 * 63), (1023, 1023), (2047, 31 * 2047)]
)
@pytest.mark.parametrize("begun", [1, 5, 30])
def test_a_block_is_not_continued_by_the_same_chip_of_a_later_one(core, length, gap, begun):
    """As where blocks are switched off amid one, and on again amid another: the code goes on where it was."""
    state = collector_of(core, length)
    collect(core, state, range(31, 31 + begun))
    again = 31 + begun + gap
    end = (again + 30) // 31 * 31
    collect(core, state, range(again, end))
    assert waiting(core, state) == []
    collect(core, state, range(end, end + 31))
    assert [block[0] for block in waiting(core, state)] == [end // 31]


@pytest.mark.parametrize("unlocked", [0, 1, 7])
def test_no_block_goes_on_behind_a_chip_that_was_not_locked(core, unlocked):
    """The code is a block long, so that every chip seems to follow the one a block before."""
    state = collector_of(core, 31)
    collect(core, state, range(31, 31 + unlocked))
    collect(core, state, [31 + unlocked], locked=False)
    collect(core, state, range(31 + unlocked + 1, 62))
    assert waiting(core, state) == []
    state = collector_of(core, 31)
    collect(core, state, range(max(unlocked, 1)))
    collect(core, state, [31 + unlocked], locked=False)
    collect(core, state, range(31 + unlocked + 1, 62))
    assert waiting(core, state) == []


def test_saturated_axes_are_those_of_any_chip_of_the_block(core, collector):
    collect(core, collector, range(30))
    collect(core, collector, [30], saturated=2)
    collect(core, collector, [31], saturated=1)
    collect(core, collector, range(32, 93))
    assert [block[3] for block in waiting(core, collector)] == [2, 1, 0]
    later = range(93, 93 + 31 * len(collector.blocks))  # In the places of those, one after the other.
    collect(core, collector, later)
    assert [block[3] for block in waiting(core, collector)] == [0] * len(collector.blocks)
    collect(core, collector, [later.stop], saturated=4)
    collect(core, collector, range(later.stop + 31, later.stop + 62))
    assert waiting(core, collector) == [(later.stop // 31 + 1, 0, later.stop + 31, 0)]


@pytest.mark.parametrize("degree", DEGREES)
@pytest.mark.parametrize("count", [0, 3, 33, 64])
def test_sums_in_tesla(core, gold_family, degree, count):
    ffi, lib = core
    rng = np.random.default_rng(100 * degree + count)
    family = gold_family(degree)
    codes = rng.integers(0, len(family), count)
    chip = int(rng.integers(0, family.shape[1]))
    samples = rng.integers(-16384, 16377, (CHIPS, 3))
    selection = ffi.new("epoch_selection_t *")
    lib.epoch_select(selection, lib.gold_family(degree), ffi.new("uint16_t[]", codes.tolist()), count)
    bits = ffi.new("code_bits_t *")
    lib.code_bits_init(bits, lib.gold_family(degree))
    block = ffi.new("block_samples_t *", {"samples": samples.tolist(), "number": 77, "cycle": 9, "chip": chip})
    calibration = ffi.new("epoch_calibration_t *", {"zero": ZERO.tolist(), "matrix": MIXED.tolist()})
    sums = ffi.new("block_sums_t *")
    lib.block_sums(block, bits, selection, calibration, sums)

    field_T = (samples / 8 + 2048 - ZERO) @ MIXED.T
    columns = np.take(family[codes], np.arange(chip, chip + CHIPS), axis=1, mode="wrap")
    expected = np.concatenate([columns, np.ones((1, CHIPS))]) @ field_T
    assert (sums.number, sums.cycle, sums.chip, sums.count, sums.unmeasured) == (77, 9, chip, count, 0)
    assert [sums.bits[i] for i in range(count)] == words(columns).tolist()
    # To a sixth of what one count of one conversion makes.
    assert np.allclose([list(sums.sums_T[i]) for i in range(count + 1)], expected, rtol=0, atol=2e-9)


@pytest.mark.parametrize(
    ("matrix", "saturated", "unmeasured"),
    [(np.diag([1e-7] * 3), 2, 2), (np.diag([1e-7] * 3), 5, 5), (MIXED, 1, 7), (MIXED, 0, 0)],
)
def test_a_saturated_axis_takes_those_along_that_the_calibration_makes_of_it(core, matrix, saturated, unmeasured):
    ffi, lib = core
    bits = ffi.new("code_bits_t *")
    lib.code_bits_init(bits, lib.gold_family(10))
    block = ffi.new("block_samples_t *", {"saturated": saturated})
    calibration = ffi.new("epoch_calibration_t *", {"matrix": matrix.tolist()})
    sums = ffi.new("block_sums_t *")
    lib.block_sums(block, bits, ffi.new("epoch_selection_t *"), calibration, sums)
    assert sums.unmeasured == unmeasured
