"""The share of a bus: the part that each of several boards gets, against exact arithmetic, and who counts as there."""

from __future__ import annotations

from fractions import Fraction

import pytest

from goldfield_protocol.rates import CAN_RATES

BIT_S = 1_000_000
MESSAGE_US, PERCENT, CREDIT_US, FORGET_US, OTHERS = 160, 75, 10_000, 500_000, 15
BLOCK_US = 3030


def make(core, now_us=0, bit_s=BIT_S):
    ffi, lib = core
    share = ffi.new("bus_share_t *")
    lib.bus_share_start(share, bit_s, now_us)
    return share


def sent(core, boards, messages, cycle_messages=0, seconds=30, bit_s=BIT_S):
    """Let so many boards ask for each of their blocks; return how many blocks each sent, and asked for."""
    _, lib = core
    shares = [make(core, 7 * board, bit_s) for board in range(boards)]
    counts, asked = [0] * boards, 0
    for now_us in range(BLOCK_US, seconds * 1_000_000, BLOCK_US):
        asked += 1
        for board, share in enumerate(shares):
            own_us = now_us + 7 * board
            if asked % 33 == 0:
                lib.bus_share_spend(share, cycle_messages, own_us)
            if lib.bus_share_take(share, messages, own_us):
                counts[board] += 1
                for other in shares:
                    if other is not share:
                        lib.bus_share_heard(other, board + 1, own_us)
    return counts, asked


@pytest.mark.parametrize("boards", [1, 2, 3, 4, 8])
@pytest.mark.parametrize(("messages", "cycle_messages"), [(9, 11), (9, 0), (13, 15), (14, 16), (33, 35), (4, 11)])
def test_boards_divide_three_quarters_of_the_bus(core, boards, messages, cycle_messages):
    counts, asked = sent(core, boards, messages, cycle_messages)
    part = Fraction(PERCENT, 100) / boards * BLOCK_US - Fraction(cycle_messages * MESSAGE_US, 33)
    expected = float(asked * min(1, part / (messages * MESSAGE_US)))
    at_first = 1 + CREDIT_US / (messages * MESSAGE_US)  # a credit that is not spent at the end, and the like
    for count in counts:
        assert count == pytest.approx(expected, abs=at_first)


@pytest.mark.parametrize("bit_s", CAN_RATES)
@pytest.mark.parametrize("boards", [1, 3])
def test_so_they_do_at_each_bit_rate(core, boards, bit_s):
    counts, asked = sent(core, boards, messages=9, cycle_messages=11, bit_s=bit_s)
    slower = BIT_S // bit_s
    part = Fraction(PERCENT, 100) / boards * BLOCK_US - Fraction(11 * MESSAGE_US * slower, 33)
    expected = float(asked * min(1, part / (9 * MESSAGE_US * slower)))
    for count in counts:
        assert count == pytest.approx(expected, abs=1 + CREDIT_US / (9 * MESSAGE_US))
    assert bit_s == BIT_S or 0 < expected < asked


def test_blocks_are_left_out_evenly(core):
    """Two boards with blocks of 9 messages: none sends two fewer or more of any twelve than of any other twelve."""
    _, lib = core
    share, went = make(core), []
    for number in range(600):
        now_us = (number + 1) * BLOCK_US
        lib.bus_share_heard(share, 5, now_us)
        went.append(lib.bus_share_take(share, 9, now_us))
    counts = [sum(went[first : first + 12]) for first in range(60, 580)]
    assert max(counts) - min(counts) <= 1
    assert 0.7 < sum(went) / len(went) < 0.85


def test_a_silent_board_is_forgotten(core):
    _, lib = core
    share = make(core)
    lib.bus_share_heard(share, 5, 1000)
    lib.bus_share_heard(share, 6, 2000)
    lib.bus_share_heard(share, 5, 3000)
    assert lib.bus_share_boards(share, 3000) == 3
    assert lib.bus_share_boards(share, 2000 + FORGET_US) == 3
    assert lib.bus_share_boards(share, 2001 + FORGET_US) == 2
    assert lib.bus_share_boards(share, 3001 + FORGET_US) == 1


def test_more_boards_than_are_told_apart_count_as_so_many(core):
    _, lib = core
    share = make(core)
    for node in range(1, 40):
        lib.bus_share_heard(share, node, 10)
    assert lib.bus_share_boards(share, 10) == 1 + OTHERS
    lib.bus_share_heard(share, 77, 20 + FORGET_US)  # it takes the place of one that is gone
    assert lib.bus_share_boards(share, 20 + FORGET_US) == 2


@pytest.mark.parametrize("silence_us", [20_000, 10**9, 2**63])
def test_no_more_than_the_credit_goes_at_once(core, silence_us):
    _, lib = core
    share = make(core)
    assert not lib.bus_share_take(share, 1, 0)
    now_us = silence_us
    assert not lib.bus_share_take(share, 63, now_us)
    assert lib.bus_share_take(share, 62, now_us)
    assert not lib.bus_share_take(share, 1, now_us)


def test_what_goes_in_any_case_is_paid_for_later_but_not_for_ever(core):
    _, lib = core
    share = make(core)
    for _ in range(100):
        lib.bus_share_spend(share, 60, 0)
    free_us = CREDIT_US * 100 // PERCENT  # behind a debt of 10 ms
    assert not lib.bus_share_take(share, 1, free_us)
    assert lib.bus_share_take(share, 1, free_us + 214)


def test_it_begins_without_credit_and_alone_whatever_lay_there(core):
    ffi, lib = core
    share = ffi.new("bus_share_t *")
    ffi.memmove(share, b"\x11" * ffi.sizeof("bus_share_t"), ffi.sizeof("bus_share_t"))
    lib.bus_share_start(share, BIT_S, 5000)
    assert not lib.bus_share_take(share, 1, 5000)
    assert lib.bus_share_boards(share, 5000) == 1
    assert not lib.bus_share_take(share, 1, 5213)
    assert lib.bus_share_take(share, 1, 5214)


def test_a_board_for_which_there_is_no_place_displaces_none(core):
    _, lib = core
    share = make(core)
    for node in range(1, 1 + OTHERS):
        lib.bus_share_heard(share, node, 10)
    lib.bus_share_heard(share, 99, 400_000)
    assert lib.bus_share_boards(share, 10 + FORGET_US) == 1 + OTHERS
    assert lib.bus_share_boards(share, 11 + FORGET_US) == 1


def test_nothing_behind_the_last_place_counts(core):
    """What lies behind looks like the board that is heard."""
    ffi, lib = core
    shares = ffi.new("bus_share_t[2]")
    lib.bus_share_start(shares, BIT_S, 0)
    shares[1].bit_ns, shares[1].credit_ns = 7, 10
    assert lib.bus_share_boards(shares, 10) == 1
    lib.bus_share_heard(shares, 7, 10)
    assert lib.bus_share_boards(shares, 10) == 2


def test_what_the_credit_just_pays_for_goes(core):
    """640 us alone on the bus are three messages, to the nanosecond."""
    _, lib = core
    share = make(core)
    assert not lib.bus_share_take(share, 3, 639)
    assert lib.bus_share_take(share, 3, 640)


def test_what_goes_in_any_case_is_paid_from_a_credit_that_was_full(core):
    """Two messages are left of 62, however long it was silent before."""
    _, lib = core
    share = make(core)
    lib.bus_share_spend(share, 60, 20_000)
    assert not lib.bus_share_take(share, 3, 20_000)
    assert lib.bus_share_take(share, 2, 20_000)
