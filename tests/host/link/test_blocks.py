"""Blocks of 31 chips out of messages: values, places and times against the samples that the messages were made of."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from goldfield.link.blocks import BLOCK_CHIPS, QUANTISATION_SD_T, BlockAssembler
from goldfield.link.chip_blocks import ChipBlockAssembler
from goldfield.link.chips import Calibration
from goldfield_protocol import decode, encode
from tests.host.fake_sensor import gold_chips

NODE, N = 100, 1023
CHIP_S = 97.75e-6
CODES = (5, 2, 1000)
COLUMNS = np.array([*(gold_chips(code) for code in CODES), np.ones(N)]).T
RATE = 1.0 + 40e-6
"""Length of a chip on the sensor's clock over the nominal one."""
START_S = 12.5


def sample(absolute):
    """The field at the end of a chip of the sensor, T: a number for each chip that no other chip has."""
    return np.array([1e-6, -2e-6, 150e-6]) + 1e-8 * np.sin(absolute * np.array([1.0, 1.7, 2.3]))


class Sender:
    """A sensor that sends blocks and headers; its first chip is chip ``ahead`` of the code, in cycle ``cycle``."""

    def __init__(self, cycle=70, ahead=20):
        self.position = cycle * N + ahead  # of absolute chip 0
        self.start_s = START_S

    def place(self, absolute):
        return divmod(self.position + int(absolute), N)

    def end_s(self, absolute):
        """Time at which a chip ends."""
        return self.start_s + (absolute + 1) * CHIP_S * RATE

    def header(self, cycle):
        middle = cycle * N - self.position + N / 2  # chips from the start
        signals = {"cycle": cycle % (1 << 20), "time": round(self.start_s + middle * CHIP_S * RATE, 6)}
        return encode("EPOCH", signals, node=NODE)

    def block(self, number):
        """The messages of a block, and the header of a cycle that ended in it."""
        absolute = number * BLOCK_CHIPS + np.arange(BLOCK_CHIPS)
        samples = np.array([sample(t) for t in absolute])
        places = [self.place(t) for t in absolute]
        columns = np.array([COLUMNS[chip] for _, chip in places])
        means = columns.T @ samples / BLOCK_CHIPS
        low = {"block_low": number % 16}
        cycle, chip = places[0]
        signals = dict(zip("xyz", means[-1], strict=True)) | low | {"cycle_low": cycle % 8}
        messages = [encode("BLOCK", signals, node=NODE, index=chip)]
        for code, mean in zip(CODES, means, strict=False):
            signals = dict(zip("xyz", mean, strict=True)) | low
            messages.append(encode("BLOCK_SUM", signals, node=NODE, index=code))
        last_cycle, last_chip = places[-1]
        if last_chip + 1 == N or last_cycle > cycle:
            messages.append(self.header(cycle))
        return messages

    def messages(self, *numbers):
        return [decode(*message) for number in numbers for message in self.block(number)]

    def check(self, block):
        """Check a block against the samples; returns its number."""
        position = block.cycle * N + block.chip - self.position
        number, rest = divmod(position, BLOCK_CHIPS)
        assert rest == 0
        absolute = position + np.arange(BLOCK_CHIPS)
        columns = np.array([COLUMNS[self.place(t)[1]] for t in absolute])
        expected = columns.T @ np.array([sample(t) for t in absolute])
        tolerance = BLOCK_CHIPS * np.array([0.2e-9] * len(CODES) + [0.4e-9]) * (1 + 1e-6)
        assert not block.sampled
        assert block.chips == BLOCK_CHIPS
        assert (np.abs(block.data_T - expected).max(axis=1) <= tolerance).all()
        assert block.time_s == pytest.approx(self.end_s(absolute[-1]), abs=12e-6)  # 40 ppm for two cycles, rounding
        return number


def assembler():
    return BlockAssembler(CODES, N, CHIP_S)


def fed(target, messages, arrival_s=0.0):
    return [block for message in messages for block in target.feed(message, arrival_s)]


def test_every_block_of_three_cycles_at_its_last_message():
    sender, target = Sender(), assembler()
    numbers = []
    for number in range(100):
        for message in sender.messages(number):
            found = [sender.check(block) for block in target.feed(message, 0.0)]
            numbers += found
            if number > 32:  # those before the first header come with it
                assert found == ([number] if message.name == "BLOCK_SUM" and message.index == CODES[-1] else [])
    assert numbers == list(range(100))
    assert (target.lost, target.late, target.repeated, target.breaks) == (0, 0, 0, 0)


def test_the_time_follows_the_length_of_a_chip_on_the_sensors_clock():
    """Ten cycles without a header: 40 ppm of the nominal length would be 40 us."""
    sender, target = Sender(), assembler()
    fed(target, [m for m in sender.messages(*range(70))])
    messages = [m for m in sender.messages(*range(70, 400)) if m.name != "EPOCH"]
    blocks = fed(target, messages)
    for block in blocks:
        position = block.cycle * N + block.chip - sender.position
        assert block.time_s == pytest.approx(sender.end_s(position + BLOCK_CHIPS - 1), abs=12e-6)
    assert len(blocks) > 200


@pytest.mark.parametrize("degree", [5, 6, 7, 9, 11])
def test_blocks_of_other_lengths_of_code(degree):
    chips = 2**degree - 1
    target = BlockAssembler((), chips, CHIP_S)
    position, found = 5, []
    for number in range(300):
        cycle, chip = divmod(position, chips)
        signals = {"x": 0.0, "y": 0.0, "z": 0.0, "block_low": number % 16, "cycle_low": cycle % 8}
        found += fed(target, [decode(*encode("BLOCK", signals, node=NODE, index=chip))])
        after = (position + BLOCK_CHIPS) // chips
        for ended in range(cycle, after):
            time_s = round((ended + 0.5) * chips * CHIP_S, 6)
            found += fed(target, [decode(*encode("EPOCH", {"cycle": ended, "time": time_s}, node=NODE))])
        position += BLOCK_CHIPS
    assert [block.cycle * chips + block.chip for block in found] == [5 + BLOCK_CHIPS * n for n in range(len(found))]
    assert len(found) > 230
    for block in found:
        end = (block.cycle * chips + block.chip + BLOCK_CHIPS) * CHIP_S
        assert block.time_s == pytest.approx(end, abs=3e-6)
    assert (target.lost, target.breaks) == (0, 0)


@pytest.mark.parametrize("missing", range(len(CODES) + 1))
def test_a_block_with_a_message_lost_is_given_up(missing):
    sender, target = Sender(), assembler()
    fed(target, sender.messages(*range(40)))
    messages = sender.messages(40)
    del messages[missing]
    assert fed(target, messages) == []
    assert [sender.check(block) for block in fed(target, sender.messages(41, 42))] == [41, 42]
    assert (target.lost, target.breaks) == (1, 0)


@pytest.mark.parametrize("gap", [1, 2, 3, 6, 7, 8, 9, 33, 100, 250])
def test_a_gap_costs_what_is_in_it(gap):
    sender, target = Sender(), assembler()
    fed(target, sender.messages(*range(70)))
    blocks = fed(target, sender.messages(*range(70 + gap, 110 + gap)))
    assert [sender.check(block) for block in blocks] == list(range(70 + gap, 110 + gap))
    assert (target.lost, target.breaks) == (gap, 0)


def test_repeated_messages_change_nothing():
    sender, target = Sender(), assembler()
    messages = [copy for message in sender.messages(*range(50)) for copy in (message, message)]
    assert [sender.check(block) for block in fed(target, messages)] == list(range(50))
    assert target.repeated == 50 * (len(CODES) + 1)


def test_a_block_in_any_order_of_its_messages():
    sender, target = Sender(), assembler()
    fed(target, sender.messages(*range(40)))
    for number in range(40, 60):
        messages = [m for m in sender.messages(number) if m.name != "EPOCH"]
        order = np.random.default_rng(number).permutation(len(messages))
        assert [sender.check(block) for block in fed(target, [messages[i] for i in order])] == [number]


def test_a_block_that_becomes_complete_behind_a_later_one_is_left_out():
    sender, target = Sender(), assembler()
    fed(target, sender.messages(*range(40)))
    *early, last = sender.messages(40)
    assert [sender.check(block) for block in fed(target, [*early, *sender.messages(41), last])] == [41]
    assert (target.lost, target.late) == (1, 1)


def test_the_number_of_the_cycle_wraps():
    sender, target = Sender(cycle=(1 << 20) - 1, ahead=0), assembler()
    blocks = fed(target, sender.messages(*range(100)))
    assert {block.cycle for block in blocks} == {(1 << 20) - 1, 0, 1, 2}
    times = np.array([block.time_s for block in blocks])
    assert np.allclose(np.diff(times), BLOCK_CHIPS * CHIP_S, atol=12e-6)


@pytest.mark.parametrize("jump", [7, -7, 5 * N, 300 * N + 11])
def test_after_a_jump_of_the_clock_blocks_wait_for_the_next_header(jump):
    sender, target = Sender(), assembler()
    fed(target, sender.messages(*range(40)))
    sender.position += jump
    blocks = fed(target, sender.messages(*range(40, 120)))
    assert [sender.check(block) for block in blocks] == list(range(40, 120))
    assert target.breaks == 1
    assert target.lost == 0


def test_a_sensor_that_starts_again():
    sender, target = Sender(), assembler()
    fed(target, sender.messages(*range(40)))
    sender = Sender(cycle=3, ahead=11)
    sender.start_s = 0.7
    blocks = fed(target, sender.messages(*range(80)))
    assert [sender.check(block) for block in blocks] == list(range(80))


@pytest.mark.parametrize("header_first", [False, True])
def test_behind_a_silence_nothing_is_guessed(header_first):
    """Sixteen cycles later the low bits are the same: the next header tells."""
    sender, target = Sender(), assembler()
    fed(target, sender.messages(*range(40)))
    later = 40 + 16 * 33
    numbers = []
    if header_first:
        fed(target, [decode(*sender.header(86))], arrival_s=1.7)
    for number in range(later, later + 40):
        numbers += [sender.check(block) for block in fed(target, sender.messages(number), arrival_s=1.7)]
    assert numbers == list(range(later, later + 40))


@pytest.mark.parametrize("axis", "xyz")
def test_an_axis_that_was_not_measured_is_not_a_number(axis):
    sender, target = Sender(), assembler()
    fed(target, sender.messages(*range(40)))
    for message in sender.messages(40):
        if message.name != "EPOCH":
            message.signals[axis] = -262144 * 8e-10 if message.name == "BLOCK" else -524288 * 4e-10
            blocks = fed(target, [message])
    place = "xyz".index(axis)
    assert np.isnan(blocks[0].data_T[:, place]).all()
    assert np.isfinite(np.delete(blocks[0].data_T, place, axis=1)).all()


def test_messages_of_other_codes_and_other_kinds_are_ignored():
    sender, target = Sender(), assembler()
    foreign = decode(*encode("BLOCK_SUM", {"x": 1e-5, "y": 0.0, "z": 0.0, "block_low": 5}, node=NODE, index=77))
    chip = decode(*encode("CHIP", {"x": 1, "y": 2, "z": 3, "cycle_low": 4}, node=NODE, index=3))
    messages = [m for message in sender.messages(*range(40)) for m in (foreign, message, chip)]
    assert [sender.check(block) for block in fed(target, messages)] == list(range(40))


@pytest.mark.parametrize("chip", [N, N + 31, 2046])
def test_a_block_of_a_longer_code_is_ignored(chip):
    sender, target = Sender(), assembler()
    fed(target, sender.messages(*range(40)))
    head, *sums = sender.messages(40)
    elsewhere = decode(*encode("BLOCK", dict(head.signals), node=NODE, index=chip))
    assert fed(target, [elsewhere, *sums]) == []
    assert [sender.check(block) for block in fed(target, sender.messages(41, 42))] == [41, 42]


PLACES = st.integers(0, 250)


@cache
def some_messages():
    return Sender().messages(*range(70))


@settings(max_examples=40, deadline=None)
@given(
    faults=st.lists(st.tuples(PLACES, st.sampled_from(["drop", "repeat", "swap", "delay"])), max_size=60),
    bursts=st.lists(st.tuples(PLACES, st.integers(1, 60)), max_size=4),
)
def test_whatever_is_lost_or_mixed_no_block_is_wrong(faults, bursts):
    sender, target = Sender(), assembler()
    messages = list(some_messages())
    for start, length in bursts:
        messages[start : start + length] = [None] * len(messages[start : start + length])
    for place, kind in faults:
        if kind == "drop":
            messages[place] = None
        elif kind == "repeat":
            messages.insert(place, messages[place])
        elif kind == "swap":
            messages[place : place + 2] = messages[place : place + 2][::-1]
        else:
            messages.insert(place + 6, messages.pop(place))
    numbers = [sender.check(block) for block in fed(target, [m for m in messages if m is not None])]
    assert numbers == sorted(set(numbers))


@settings(max_examples=40, deadline=None)
@given(st.lists(st.tuples(st.sampled_from(["EPOCH", "BLOCK", "BLOCK_SUM", "CHIP"]), st.binary(min_size=8, max_size=8))))
def test_any_bytes_are_survived(frames):
    targets = assembler(), ChipBlockAssembler(N, CHIP_S, PLAIN)
    for name, data in frames:
        identifier, _ = encode(name, {s: 0.0 for s in SIGNALS[name]}, node=NODE, index=INDICES[name](data))
        for target in targets:
            for block in target.feed(decode(identifier, data), 0.0):
                assert np.isfinite(block.time_s)
                assert block.data_T.shape[1] == 3


SIGNALS = {
    "EPOCH": ("cycle", "time"),
    "BLOCK": ("x", "y", "z", "cycle_low", "block_low"),
    "BLOCK_SUM": ("x", "y", "z", "block_low"),
    "CHIP": ("x", "y", "z", "cycle_low"),
}
INDICES = {
    "EPOCH": lambda data: 0,
    "BLOCK": lambda data: data[0] * 8 % 2047,
    "BLOCK_SUM": lambda data: CODES[data[1] % len(CODES)],
    "CHIP": lambda data: data[0] % 40,
}
PLAIN = Calibration(np.array([2048.0, 2048.0, 2048.0]), np.eye(3) * 1e-7)


def test_rounding_on_the_wire_adds_as_much_as_is_said():
    """Sums of white noise of 31 samples, rounded: their excess over the exact ones, in the unit of a sample's noise."""
    rng = np.random.default_rng(3)
    means = rng.normal(scale=5e-9 / BLOCK_CHIPS**0.5, size=4000) + 1e-6 * rng.random(4000)
    for name, index, told in (("BLOCK", 0, QUANTISATION_SD_T[0]), ("BLOCK_SUM", 2, QUANTISATION_SD_T[1])):
        signals = dict.fromkeys(SIGNALS[name], 0.0)
        errors = []
        for mean in means:
            message = decode(*encode(name, signals | {"x": float(mean)}, node=NODE, index=index))
            errors.append(message.signals["x"] - mean)
        assert BLOCK_CHIPS * np.std(errors) / BLOCK_CHIPS**0.5 == pytest.approx(told, rel=0.03)
    assert (QUANTISATION_SD_T[0] / 5e-9) ** 2 < 0.07  # of the variance of the least noise that a sample has
    assert (QUANTISATION_SD_T[1] / 5e-9) ** 2 < 0.02


class Streamer(Sender):
    """A sensor that streams chips."""

    def chips(self, first, last):
        for absolute in range(first, last):
            cycle, chip = self.place(absolute)
            counts = [absolute % 7000, -(absolute % 5000), 3]
            signals = dict(zip("xyz", counts, strict=True)) | {"cycle_low": cycle % 65536}
            yield decode(*encode("CHIP", signals, node=NODE, index=chip))
            if chip + 1 == N:
                yield decode(*self.header(cycle))

    def check_samples(self, block):
        absolute = block.cycle * N + block.chip - self.position
        expected = [[t % 7000, -(t % 5000), 3] for t in range(absolute, absolute + BLOCK_CHIPS)]
        assert block.sampled
        assert np.allclose(block.data_T, np.array(expected) / 8 * 1e-7, rtol=1e-9, equal_nan=True)
        assert block.time_s == pytest.approx(self.end_s(absolute + BLOCK_CHIPS - 1), abs=16e-6)
        return absolute


def chip_assembler():
    return ChipBlockAssembler(N, CHIP_S, PLAIN)


def test_streamed_chips_become_blocks_of_samples():
    sender, target = Streamer(), chip_assembler()
    firsts = [sender.check_samples(block) for block in fed(target, sender.chips(0, 4000))]
    assert firsts[0] == N - 20  # the first header
    assert firsts == list(range(firsts[0], 4000 - 30, 31))
    assert target.lost == 0


@pytest.mark.parametrize(("lost", "blocks"), [(1, 1), (31, 2), (40, 2), (2000, 65)])
def test_lost_chips_cost_their_blocks(lost, blocks):
    sender, target = Streamer(), chip_assembler()
    before = fed(target, sender.chips(0, 2000))
    after = fed(target, sender.chips(2000 + lost, 6000))
    firsts = [sender.check_samples(block) for block in before + after]
    missing = sorted(set(range(firsts[0], 6000 - 30, 31)) - set(firsts))
    assert len(missing) == target.lost
    assert all(first < 2000 + lost and first + 31 > 2000 for first in missing)
    assert abs(target.lost - blocks) <= 1


def test_repeated_and_late_chips_change_nothing():
    sender, target = Streamer(), chip_assembler()
    messages = list(sender.chips(0, 3000))
    rng = np.random.default_rng(1)
    for place in sorted(rng.integers(0, 2900, 40), reverse=True):
        messages.insert(place + rng.integers(1, 30), messages[place])
    firsts = [sender.check_samples(block) for block in fed(target, messages)]
    assert firsts == list(range(N - 20, 3000 - 30, 31))


def test_a_saturated_axis_of_a_streamed_chip():
    sender, target = Streamer(), chip_assembler()
    fed(target, sender.chips(0, N - 20))
    messages = [m for m in sender.chips(N - 20, N + 11) if m.name == "CHIP"]
    messages[4].signals["y"] = -32768
    (block,) = fed(target, messages)
    assert np.argwhere(np.isnan(block.data_T)).tolist() == [[4, 1]]


@pytest.mark.parametrize("jump", [7, 400 * N + 3, -60 * N])
def test_chips_behind_a_jump_of_the_clock(jump):
    sender, target = Streamer(), chip_assembler()
    fed(target, sender.chips(0, 2000))
    sender.position += jump
    blocks = fed(target, sender.chips(2000, 6000))
    settled = [block for block in blocks if block.time_s > sender.end_s(2000 + 1100)]
    assert len(settled) > 80
    for block in settled:
        sender.check_samples(block)
