"""A second reading of bxCAN: modes, transmission, errors (see ``second_reading_bench``).

Sections are those of RM0090 Rev 21: 32 bxCAN. Counters and states are ISO 11898-1's fault confinement (12.1.4).
The test is the network: what a mailbox wants is at the chip's edge, and the test says how it went.
"""

import pytest

from hil_sim.emulator.bench import Bench
from tests.hil_sim.emulator.second_reading_bench import (
    ABOM,
    ABRQ,
    AWUM,
    BIT,
    BIT_TIMING,
    BOFF,
    BTR,
    CAN1,
    EPVF,
    ESR,
    EWGF,
    FMP,
    FMR,
    INAK,
    INRQ,
    LISTENS,
    MCR,
    MSR,
    NART,
    RF0R,
    RQCP,
    SLAK,
    SLEEP,
    TERR,
    TSR,
    TXFP,
    TXOK,
    WKUI,
    accept_all,
    bus_error,
    can_start,
    counters,
    empty,
    receive,
    request,
    sent,
    status,
)

# ---- Modes ----


def test_out_of_reset_it_sleeps(fast_chip: Bench) -> None:
    """32.4, 32.9.2: after reset bxCAN is in sleep mode: MCR 0x10002, SLAK set, INAK not; the mailboxes are empty."""
    assert fast_chip.read(CAN1 + MCR) == 0x10002
    assert fast_chip.read(CAN1 + MSR) & (SLAK | INAK) == SLAK
    assert fast_chip.read(CAN1 + TSR) == 0x1C000000
    assert fast_chip.read(CAN1 + BTR) == 0x01230000
    assert fast_chip.read(CAN1 + FMR) == 0x2A1C0E01


def test_normal_mode_needs_eleven_recessive_bits(fast_chip: Bench) -> None:
    """32.4.2: INAK is cleared only after 11 consecutive recessive bits, 11 us at 1 Mbit/s."""
    fast_chip.alternate("B", 8, 9)
    fast_chip.alternate("B", 9, 9)
    fast_chip.operations.pin_in(fast_chip.board, 24, True, fast_chip.now)
    fast_chip.write(CAN1 + MCR, INRQ)
    fast_chip.run(30 * BIT)
    assert fast_chip.read(CAN1 + MSR) & (INAK | SLAK) == INAK
    fast_chip.write(CAN1 + BTR, BIT_TIMING)
    fast_chip.write(CAN1 + MCR, 0)
    fast_chip.run(10.5 * BIT)
    assert fast_chip.read(CAN1 + MSR) & INAK
    fast_chip.run(2 * BIT)
    assert not fast_chip.read(CAN1 + MSR) & INAK


@pytest.mark.parametrize("mode", [INRQ, SLEEP])
def test_leaving_normal_mode_during_a_frame_is_refused(fast_chip: Bench, mode: int) -> None:
    """32.9.2 INRQ, SLEEP: the hardware waits until the current transmission is completed before it acknowledges.

    The network does not tell when a frame begins, so the model must not acknowledge at once without a word.
    """
    can_start(fast_chip)
    request(fast_chip, 0, 0x123)
    fast_chip.run(20 * BIT)
    fast_chip.write(CAN1 + MCR, mode)
    fast_chip.expect("may be on the bus")


def test_leaving_normal_mode_on_an_idle_bus(fast_chip: Bench) -> None:
    """32.9.2 INRQ: with nothing on the bus INAK follows at once; what the mailboxes have sent stays in TSR."""
    can_start(fast_chip)
    request(fast_chip, 0, 0x123)
    fast_chip.run(60 * BIT)
    sent(fast_chip, 0)
    fast_chip.write(CAN1 + MCR, INRQ)
    fast_chip.run(5 * BIT)
    assert fast_chip.read(CAN1 + MSR) & INAK
    assert status(fast_chip, 0) & (RQCP | TXOK) == RQCP | TXOK


def test_sleep_and_wake_up_by_software(fast_chip: Bench) -> None:
    """32.4.3: SLAK confirms; after SLEEP is cleared sleep mode ends once 11 recessive bits were seen."""
    can_start(fast_chip)
    fast_chip.write(CAN1 + MCR, SLEEP)
    fast_chip.run(5 * BIT)
    assert fast_chip.read(CAN1 + MSR) & SLAK
    fast_chip.write(CAN1 + MCR, 0)
    fast_chip.run(10 * BIT)
    assert fast_chip.read(CAN1 + MSR) & SLAK
    fast_chip.run(3 * BIT)
    assert not fast_chip.read(CAN1 + MSR) & SLAK


def test_a_frame_wakes_it_up_and_is_lost(fast_chip: Bench) -> None:
    """32.4.3, AWUM: activity sets WKUI and clears SLEEP; the frame itself is not received."""
    can_start(fast_chip, AWUM)
    accept_all(fast_chip)
    fast_chip.write(CAN1 + MCR, AWUM | SLEEP)
    fast_chip.run(5 * BIT)
    receive(fast_chip, 0x100)
    assert not fast_chip.read(CAN1 + RF0R) & FMP
    assert not fast_chip.read(CAN1 + MCR) & SLEEP
    assert fast_chip.read(CAN1 + MSR) & (WKUI | SLAK) == WKUI | SLAK, "not yet 11 recessive bits"
    fast_chip.run(15 * BIT)
    assert not fast_chip.read(CAN1 + MSR) & SLAK
    receive(fast_chip, 0x101)
    assert fast_chip.read(CAN1 + RF0R) & FMP == 1


# ---- Transmission ----


@pytest.mark.parametrize(
    ("identifiers", "lowest"),
    [
        ((0x100, 0x300, 0x200), 1),
        ((0x300, 0x100, 0x200), 0),
        ((0x100, 0x300, 0x300), 2),
        ((0x123 << 18 | 1 << 31, 0x123, 0x122), 0),
        ((0x123, 0x122 << 18 | 1 << 31, 0x124), 2),
    ],
)
def test_priority_is_the_identifier_and_then_the_mailbox(
    fast_chip: Bench, identifiers: tuple[int, ...], lowest: int
) -> None:
    """32.7.1: the lowest identifier has the highest priority by CAN's arbitration, of equal ones the lower mailbox.

    SRR and IDE are recessive, so an extended identifier (here with bit 31) loses against a standard one of its base
    bits. LOW of TSR says which mailbox is last; which one is first at the bus is the rig's own arbitration.
    """
    can_start(fast_chip)
    for box, identifier in enumerate(identifiers):
        request(fast_chip, box, identifier & 0x1FFFFFFF, extended=bool(identifier >> 31))
    assert fast_chip.read(CAN1 + TSR) >> 29 == 1 << lowest
    assert fast_chip.read(CAN1 + TSR) >> 24 & 3 == lowest


def test_txfp_sends_in_the_order_of_requests(fast_chip: Bench) -> None:
    """32.7.1, by transmit request order: TXFP makes the mailboxes a FIFO whatever their identifiers."""
    can_start(fast_chip, TXFP)
    request(fast_chip, 1, 0x500)
    request(fast_chip, 2, 0x300)
    request(fast_chip, 0, 0x100)
    for box in (1, 2, 0):
        fast_chip.run(60 * BIT)
        assert fast_chip.edge.frames[-1][0] == box
        sent(fast_chip, box)
    assert [frame[0] for frame in fast_chip.edge.frames] == [1, 2, 0]


def test_code_and_low_of_the_status(fast_chip: Bench) -> None:
    """32.9.2 TSR: CODE is the next free mailbox, or the one of lowest priority if none is; LOW only if several wait."""
    can_start(fast_chip)
    assert fast_chip.read(CAN1 + TSR) >> 24 & 3 == 0
    request(fast_chip, 0, 0x200)
    fast_chip.run(20 * BIT)
    assert fast_chip.read(CAN1 + TSR) >> 29 == 0
    assert fast_chip.read(CAN1 + TSR) >> 24 & 3 == 1
    request(fast_chip, 1, 0x700)
    assert fast_chip.read(CAN1 + TSR) >> 24 & 3 == 2
    assert fast_chip.read(CAN1 + TSR) >> 29 == 1 << 1
    request(fast_chip, 2, 0x600)
    assert fast_chip.read(CAN1 + TSR) >> 24 & 3 == 1
    assert fast_chip.read(CAN1 + TSR) >> 29 == 1 << 1


def test_a_mailbox_completes_when_its_frame_has_ended(fast_chip: Bench) -> None:
    """32.7.1: RQCP and TXOK, TME again; clearing RQCP clears TXOK; a new request clears RQCP."""
    can_start(fast_chip)
    request(fast_chip, 0, 0x123, b"abcdefg")
    assert not empty(fast_chip, 0)
    fast_chip.run(70 * BIT)
    assert not status(fast_chip, 0) & RQCP
    sent(fast_chip, 0)
    assert status(fast_chip, 0) == RQCP | TXOK
    assert empty(fast_chip, 0)
    fast_chip.write(CAN1 + TSR, RQCP)
    assert status(fast_chip, 0) == 0
    request(fast_chip, 0, 0x124)
    fast_chip.run(70 * BIT)
    sent(fast_chip, 0)
    assert status(fast_chip, 0) == RQCP | TXOK
    request(fast_chip, 0, 0x125)
    assert status(fast_chip, 0) == 0
    assert fast_chip.edge.frames[0][1:4] == (0x123, False, b"abcdefg")


def test_abort_of_what_waits(fast_chip: Bench) -> None:
    """32.7.1, abort: a mailbox that waits for another (TXFP) is empty at once, with RQCP and without TXOK."""
    can_start(fast_chip, TXFP)
    request(fast_chip, 0, 0x100)
    request(fast_chip, 1, 0x200)
    fast_chip.run(20 * BIT)
    fast_chip.write(CAN1 + TSR, ABRQ << 8)
    fast_chip.run(2 * BIT)
    assert empty(fast_chip, 1)
    assert status(fast_chip, 1) == RQCP
    sent(fast_chip, 0)
    fast_chip.run(20 * BIT)
    assert len(fast_chip.edge.frames) == 1


def test_abort_of_what_may_be_on_the_bus_is_refused(fast_chip: Bench) -> None:
    """32.7.1, abort: a mailbox in transmission becomes empty by the outcome, with TXOK if the frame went through.

    The network does not tell when a frame begins, so the model must not call it aborted without a word.
    """
    can_start(fast_chip)
    request(fast_chip, 0, 0x100)
    fast_chip.run(20 * BIT)
    fast_chip.write(CAN1 + TSR, ABRQ)
    fast_chip.expect("may be on the bus")


@pytest.mark.parametrize(("written", "left"), [(TXOK, RQCP), (RQCP, 0), (TERR, RQCP | TXOK)])
def test_status_bits_are_cleared_one_by_one(fast_chip: Bench, written: int, left: int) -> None:
    """32.9.2 TSR: TERR, ALST and TXOK are rc_w1 themselves; clearing RQCP clears all of them."""
    can_start(fast_chip)
    request(fast_chip, 0, 0x100)
    fast_chip.run(60 * BIT)
    sent(fast_chip, 0)
    fast_chip.write(CAN1 + TSR, written)
    assert status(fast_chip, 0) == left


def test_without_nart_a_failed_frame_is_sent_again(fast_chip: Bench) -> None:
    """32.9.2 NART = 0: the hardware retransmits until it succeeds; the mailbox stays pending meanwhile."""
    can_start(fast_chip)
    request(fast_chip, 0, 0x100)
    for _ in range(3):
        fast_chip.run(60 * BIT)
        sent(fast_chip, 0, ok=False)
        assert not empty(fast_chip, 0)
        assert not status(fast_chip, 0) & RQCP
    fast_chip.run(60 * BIT)
    assert len(fast_chip.edge.frames) == 4
    sent(fast_chip, 0)
    assert status(fast_chip, 0) & (RQCP | TXOK) == RQCP | TXOK


def test_with_nart_a_failed_frame_is_over(fast_chip: Bench) -> None:
    """32.7.1, nonautomatic retransmission: RQCP after the first attempt, TXOK clear, TERR for an error."""
    can_start(fast_chip, NART)
    request(fast_chip, 0, 0x100)
    fast_chip.run(60 * BIT)
    sent(fast_chip, 0, ok=False)
    assert empty(fast_chip, 0)
    assert status(fast_chip, 0) == RQCP | TERR
    fast_chip.run(200 * BIT)
    assert len(fast_chip.edge.frames) == 1


# ---- Error counters and states ----


def test_a_lone_node_becomes_passive_but_never_bus_off(fast_chip: Bench) -> None:
    """ISO 11898-1, 12.1.4.2 c), exception 1: an acknowledgement error adds 8, but none to an error-passive transmitter.

    32.9.2 ESR: EWGF from 96 on, EPVF above 127, LEC 3 is the acknowledgement error.
    """
    can_start(fast_chip)
    request(fast_chip, 0, 0x100)
    for n in range(1, 41):
        fast_chip.run(60 * BIT)
        sent(fast_chip, 0, ok=False)
        fast_chip.run(20 * BIT)
        tec = min(8 * n, 128)
        assert counters(fast_chip)[0] == tec
        expected = (EWGF if tec >= 96 else 0) | (EPVF if tec > 127 else 0)
        assert fast_chip.read(CAN1 + ESR) & 7 == expected
        assert fast_chip.read(CAN1 + ESR) >> 4 & 7 == 3
    fast_chip.run(60 * BIT)
    sent(fast_chip, 0)
    assert counters(fast_chip)[0] == 127
    assert fast_chip.read(CAN1 + ESR) & 7 == EWGF
    assert fast_chip.read(CAN1 + ESR) >> 4 & 7 == 0, "LEC is cleared by a good frame"


def to_bus_off(chip: Bench) -> None:
    """Bit errors until TEC overflows: 32 of 8 each."""
    request(chip, 0, 0x100)
    for _ in range(31):
        chip.run(60 * BIT)
        bus_error(chip, 0)
        chip.run(20 * BIT)
    assert counters(chip)[0] == 248
    assert not chip.read(CAN1 + ESR) & BOFF
    chip.run(60 * BIT)
    bus_error(chip, 0)


def test_bit_errors_of_a_transmitter_lead_to_bus_off_above_255(fast_chip: Bench) -> None:
    """ISO 11898-1, 12.1.4.2 c): +8 each, passive or not; 32.7.6: bus-off when TEC is greater than 255."""
    can_start(fast_chip)
    to_bus_off(fast_chip)
    assert fast_chip.read(CAN1 + ESR) & BOFF
    requests = len(fast_chip.edge.frames)
    fast_chip.run(3000 * BIT)
    assert fast_chip.read(CAN1 + ESR) & BOFF, "ABOM = 0: it stays until software asks (32.7.6)"
    assert len(fast_chip.edge.frames) == requests


def test_a_missing_acknowledgement_leaves_a_passive_transmitter_where_it_is(fast_chip: Bench) -> None:
    """ISO 11898-1, 12.1.4.2 c), exception 1: TEC is not changed then, whatever beyond the limit it has come to."""
    can_start(fast_chip)
    request(fast_chip, 0, 0x100)
    for _ in range(25):
        fast_chip.run(60 * BIT)
        bus_error(fast_chip, 0)
        fast_chip.run(20 * BIT)
    assert counters(fast_chip)[0] == 200
    fast_chip.run(60 * BIT)
    sent(fast_chip, 0, ok=False)
    assert counters(fast_chip)[0] == 200


def test_abom_leaves_bus_off_after_128_times_11_bits(fast_chip: Bench) -> None:
    """32.7.6, ABOM: left by itself after at least 128 times 11 recessive bits; the counters are 0 then."""
    can_start(fast_chip, ABOM)
    to_bus_off(fast_chip)
    fast_chip.run(1400 * BIT)
    assert fast_chip.read(CAN1 + ESR) & BOFF
    fast_chip.run(40 * BIT)
    assert not fast_chip.read(CAN1 + ESR) & BOFF
    assert counters(fast_chip) == (0, 0)
    assert fast_chip.read(CAN1 + ESR) & (EPVF | EWGF) == 0


def test_software_leaves_bus_off_by_initialisation_and_then_waits(fast_chip: Bench) -> None:
    """32.7.6: with ABOM = 0 INRQ is set and cleared, and the 128 x 11 bits are counted in normal mode only."""
    can_start(fast_chip)
    to_bus_off(fast_chip)
    fast_chip.write(CAN1 + MCR, INRQ)
    fast_chip.run(3000 * BIT)
    assert fast_chip.read(CAN1 + ESR) & BOFF, "in initialization mode CANRX is not monitored"
    fast_chip.write(CAN1 + MCR, 0)
    fast_chip.run(1400 * BIT)
    assert fast_chip.read(CAN1 + ESR) & BOFF
    fast_chip.run(60 * BIT)
    assert not fast_chip.read(CAN1 + ESR) & BOFF
    assert counters(fast_chip) == (0, 0)


def test_receive_errors_count_one_and_good_frames_take_one_away(fast_chip: Bench) -> None:
    """ISO 11898-1, 12.1.4.2 a), h): a receiver's error adds 1, a good reception takes 1 away."""
    can_start(fast_chip)
    accept_all(fast_chip)
    for n in range(1, 6):
        bus_error(fast_chip, LISTENS)
        fast_chip.run(20 * BIT)
        assert counters(fast_chip) == (0, n)
    receive(fast_chip, 0x100)
    assert counters(fast_chip) == (0, 4)


def test_a_passive_receiver_returns_below_the_limit_at_the_first_good_frame(fast_chip: Bench) -> None:
    """ISO 11898-1, 12.1.4.2 h): if REC was greater than 127, it is set to a value between 119 and 127."""
    can_start(fast_chip)
    accept_all(fast_chip)
    for _ in range(140):
        bus_error(fast_chip, LISTENS)
        fast_chip.run(20 * BIT)
    assert counters(fast_chip)[1] > 127
    assert fast_chip.read(CAN1 + ESR) & EPVF
    receive(fast_chip, 0x100)
    assert 119 <= counters(fast_chip)[1] <= 127
    assert not fast_chip.read(CAN1 + ESR) & EPVF
