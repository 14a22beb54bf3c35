"""A second reading of bxCAN: reception, filters, test modes, interrupts (see ``second_reading_bench``).

Sections are those of RM0090 Rev 21: 32 bxCAN. Counters and states are ISO 11898-1's fault confinement (12.1.4).
The test is the network: what a mailbox wants is at the chip's edge, and the test says how it went.
"""

from hil_sim.emulator.bench import Bench
from tests.hil_sim.emulator.second_reading_bench import (
    BIT,
    CAN1,
    ERRI,
    FA1R,
    FILTER,
    FMP,
    FMR,
    FOVR,
    FULL,
    IER,
    LBKM,
    MCR,
    MSR,
    RF0R,
    RF1R,
    RFLM,
    RI0R,
    RQCP,
    SILM,
    SLAK,
    TI0R,
    TSR,
    TXOK,
    accept_all,
    can_start,
    counters,
    filters,
    message,
    receive,
    release,
    request,
    sent,
    status,
)

CAN1_TX, CAN1_RX0, CAN1_SCE = 19, 20, 22


# ---- Reception ----


def test_a_frame_in_the_output_mailbox(fast_chip: Bench) -> None:
    """32.9.3: identifiers in RIR[31:21] or RIR[31:3] with IDE; data byte 0 is the lowest; FMP counts."""
    can_start(fast_chip)
    accept_all(fast_chip)
    receive(fast_chip, 0x123, b"\x01\x02\x03\x04\x05")
    receive(fast_chip, 0x1234567, b"xyz", extended=True)
    assert fast_chip.read(CAN1 + RF0R) & FMP == 2
    assert message(fast_chip) == (0x123 << 21, 0, b"\x01\x02\x03\x04\x05")
    release(fast_chip)
    assert fast_chip.read(CAN1 + RF0R) & FMP == 1
    assert message(fast_chip) == (0x1234567 << 3 | 4, 0, b"xyz")
    release(fast_chip)
    assert fast_chip.read(CAN1 + RF0R) & FMP == 0
    release(fast_chip)
    assert fast_chip.read(CAN1 + RF0R) & FMP == 0, "releasing an empty FIFO has no effect"


def test_overrun_without_lock_overwrites_the_last(fast_chip: Bench) -> None:
    """32.7.3, RFLM = 0: the last message stored is overwritten by the new one; FOVR."""
    can_start(fast_chip)
    accept_all(fast_chip)
    for identifier in (1, 2, 3):
        receive(fast_chip, identifier)
    assert fast_chip.read(CAN1 + RF0R) & (FMP | FULL | FOVR) == 3 | FULL
    receive(fast_chip, 4)
    assert fast_chip.read(CAN1 + RF0R) & (FMP | FULL | FOVR) == 3 | FULL | FOVR
    fast_chip.expect("overrun")
    seen = []
    for _ in range(3):
        seen.append(message(fast_chip)[0] >> 21)
        release(fast_chip)
    assert seen == [1, 2, 4]
    fast_chip.write(CAN1 + RF0R, FOVR | FULL)
    assert fast_chip.read(CAN1 + RF0R) == 0


def test_full_is_software_s_to_clear(fast_chip: Bench) -> None:
    """32.9.2 RF0R, FULL: set when three messages are stored, cleared by software; releasing one does not clear it."""
    can_start(fast_chip)
    accept_all(fast_chip)
    for identifier in (1, 2, 3):
        receive(fast_chip, identifier)
    release(fast_chip)
    assert fast_chip.read(CAN1 + RF0R) & (FMP | FULL) == 2 | FULL
    fast_chip.write(CAN1 + RF0R, FULL)
    fast_chip.run(BIT)
    assert fast_chip.read(CAN1 + RF0R) & (FMP | FULL) == 2


def test_overrun_with_lock_drops_the_new(fast_chip: Bench) -> None:
    """32.7.3, RFLM = 1: the most recent message is discarded, the three oldest are available; FOVR as well."""
    can_start(fast_chip, RFLM)
    accept_all(fast_chip)
    for identifier in (1, 2, 3, 4, 5):
        receive(fast_chip, identifier)
    assert fast_chip.read(CAN1 + RF0R) & FOVR
    fast_chip.expect("overrun")
    seen = []
    for _ in range(3):
        seen.append(message(fast_chip)[0] >> 21)
        release(fast_chip)
    assert seen == [1, 2, 3]


# ---- Filters ----


def test_a_wide_mask_looks_at_ide_and_rtr_too(fast_chip: Bench) -> None:
    """Figure 342, 32-bit mask: STID[10:0] EXID[17:0] IDE RTR 0, as in RIR; a mask bit of 1 must match."""
    can_start(fast_chip)
    filters(fast_chip, {0: (0x100 << 21, 0x700 << 21 | 6)}, wide=1)
    receive(fast_chip, 0x1FF)
    receive(fast_chip, 0x200)
    receive(fast_chip, 0x100, remote=True)
    receive(fast_chip, 0x100 << 18, extended=True)
    assert fast_chip.read(CAN1 + RF0R) & FMP == 1
    assert message(fast_chip)[0] == 0x1FF << 21


def test_narrow_lists_hold_four_identifiers(fast_chip: Bench) -> None:
    """Figure 342, 16-bit list: STID[10:0] RTR IDE EXID[17:15]; filter n is R1 low, R1 high, R2 low, R2 high."""
    can_start(fast_chip)
    identifiers = (0x101, 0x202, 0x303, 0x404)
    halves = [identifier << 5 for identifier in identifiers]
    filters(fast_chip, {0: (halves[1] << 16 | halves[0], halves[3] << 16 | halves[2])}, lists=1)
    for index, identifier in enumerate(identifiers):
        receive(fast_chip, identifier)
        assert message(fast_chip)[:2] == (identifier << 21, index)
        release(fast_chip)
    receive(fast_chip, 0x102)
    receive(fast_chip, 0x101, remote=True)
    assert fast_chip.read(CAN1 + RF0R) & FMP == 0


def test_narrow_masks_pair_the_halves_of_one_register(fast_chip: Bench) -> None:
    """Figure 342, 16-bit mask: R1 low is an identifier, R1 high its mask; R2 the same: two filters."""
    can_start(fast_chip)
    filters(fast_chip, {0: (0x7FF << 21 | 0x111 << 5, 0x700 << 21 | 0x200 << 5)})
    receive(fast_chip, 0x111)
    assert message(fast_chip)[1] == 0
    release(fast_chip)
    receive(fast_chip, 0x2AB)
    assert message(fast_chip)[1] == 1
    release(fast_chip)
    receive(fast_chip, 0x112)
    assert fast_chip.read(CAN1 + RF0R) & FMP == 0


def test_match_index_counts_by_fifo_and_through_what_is_off(fast_chip: Bench) -> None:
    """32.7.4: two numbering schemes, one for each FIFO; the index does not take the activation state into account.

    Bank 0 (FIFO 0) is a 32-bit list: 0, 1. Bank 1 (FIFO 1) a 32-bit mask: 0. Bank 2 (FIFO 0, off) a 16-bit list: 2
    to 5. Bank 3 (FIFO 1) a 16-bit mask: 1, 2. Bank 4 (FIFO 0) a 32-bit mask: 6.
    """
    can_start(fast_chip)
    exact = 0x7FF << 21 | 6
    banks = {
        0: (0x010 << 21, 0x011 << 21),
        1: (0x020 << 21, exact),
        2: (0, 0),
        3: (0x7FF << 21 | 0x030 << 5, 0x7FF << 21 | 0x031 << 5),
        4: (0x040 << 21, exact),
    }
    filters(fast_chip, banks, lists=0b00101, wide=0b10011, second_fifo=0b01010, off=0b00100)
    for identifier, fifo, index in (
        (0x010, 0, 0),
        (0x011, 0, 1),
        (0x040, 0, 6),
        (0x020, 1, 0),
        (0x030, 1, 1),
        (0x031, 1, 2),
    ):
        receive(fast_chip, identifier)
        assert fast_chip.read(CAN1 + RF0R + 4 * fifo) & FMP == 1
        assert fast_chip.read(CAN1 + RF0R + 4 * (1 - fifo)) & FMP == 0
        assert message(fast_chip, fifo)[:2] == (identifier << 21, index)
        release(fast_chip, fifo)


def test_priority_of_filters(fast_chip: Bench) -> None:
    """32.7.4: 32 bits before 16; of equal scale a list before a mask; else the lower filter number.

    All banks let 0x123 pass. Bank 0: 16-bit mask, bank 1: 16-bit list, bank 2: 32-bit mask, bank 3: 32-bit list. They
    are taken away one after another.
    """
    can_start(fast_chip)
    narrow = 0x123 << 5
    banks = {
        0: (0x7FF << 21 | narrow, 0x7FF << 21 | narrow),
        1: (narrow << 16 | narrow, narrow << 16 | narrow),
        2: (0x123 << 21, 0x7FF << 21),
        3: (0x123 << 21, 0x123 << 21),
    }
    seen = []
    for off in (0b0000, 0b1000, 0b1100, 0b1110):
        filters(fast_chip, banks, lists=0b1010, wide=0b1100, off=off)
        receive(fast_chip, 0x123)
        seen.append(message(fast_chip)[1])
        release(fast_chip)
    assert seen == [7, 6, 2, 0]


def test_filters_of_the_other_half_belong_to_can2(fast_chip: Bench) -> None:
    """32.9.4 CAN2SB: 14 after reset, so banks 14 to 27 are CAN2's; with 28 all are CAN1's."""
    can_start(fast_chip)
    filters(fast_chip, {14: (0, 0)}, wide=1 << 14)
    receive(fast_chip, 0x123)
    assert fast_chip.read(CAN1 + RF0R) & FMP == 0


def test_no_reception_while_filters_are_initialised(fast_chip: Bench) -> None:
    """32.4.1, note: when FINIT = 1, CAN reception is deactivated."""
    can_start(fast_chip)
    accept_all(fast_chip)
    fast_chip.write(CAN1 + FMR, fast_chip.read(CAN1 + FMR) | 1)
    receive(fast_chip, 0x123)
    fast_chip.write(CAN1 + FMR, fast_chip.read(CAN1 + FMR) & ~1)
    assert fast_chip.read(CAN1 + RF0R) & FMP == 0


def test_both_fifos_hold_messages_apart(fast_chip: Bench) -> None:
    """32.9.4 FFA: what passes a filter goes into its FIFO; they fill and are released apart."""
    can_start(fast_chip)
    exact = 0x7FF << 21 | 6
    filters(fast_chip, {0: (0x010 << 21, exact), 1: (0x020 << 21, exact)}, wide=3, second_fifo=2)
    for _ in range(3):
        receive(fast_chip, 0x020)
    receive(fast_chip, 0x010)
    assert fast_chip.read(CAN1 + RF1R) & (FMP | FULL) == 3 | FULL
    assert fast_chip.read(CAN1 + RF0R) & (FMP | FULL) == 1


# ---- Test modes and interrupts ----


def test_loop_back_receives_what_it_sends_without_acknowledgement(fast_chip: Bench) -> None:
    """32.5.2, 32.5.3: own messages pass the filters, acknowledge errors are ignored; with SILM the pin rests."""
    can_start(fast_chip, test_mode=LBKM | SILM)
    accept_all(fast_chip)
    request(fast_chip, 0, 0x123, b"loop")
    fast_chip.run(200 * BIT)
    assert status(fast_chip, 0) == RQCP | TXOK
    assert message(fast_chip) == (0x123 << 21, 0, b"loop")
    assert not fast_chip.edge.frames
    assert counters(fast_chip) == (0, 0)


def test_silent_mode_listens_and_never_sends(fast_chip: Bench) -> None:
    """32.5.1: valid frames are received, but no transmission can be started."""
    can_start(fast_chip, test_mode=SILM)
    accept_all(fast_chip)
    receive(fast_chip, 0x123)
    assert fast_chip.read(CAN1 + RF0R) & FMP == 1
    request(fast_chip, 0, 0x100)
    fast_chip.run(300 * BIT)
    assert not fast_chip.edge.frames
    assert not status(fast_chip, 0) & TXOK


def test_interrupt_lines(fast_chip: Bench) -> None:
    """32.8, figure 348: FMPIE while FMP is not 0, TMEIE while RQCP; each on its own line (RM0090 table 62)."""
    can_start(fast_chip)
    accept_all(fast_chip)
    fast_chip.write(CAN1 + IER, 3)
    receive(fast_chip, 0x123)
    receive(fast_chip, 0x124)
    assert fast_chip.irq(CAN1_RX0)
    release(fast_chip)
    assert fast_chip.irq(CAN1_RX0)
    release(fast_chip)
    assert not fast_chip.irq(CAN1_RX0)
    request(fast_chip, 0, 0x100)
    fast_chip.run(60 * BIT)
    assert not fast_chip.irq(CAN1_TX)
    sent(fast_chip, 0)
    assert fast_chip.irq(CAN1_TX)
    fast_chip.write(CAN1 + TSR, RQCP)
    assert not fast_chip.irq(CAN1_TX)


def test_error_interrupt_needs_its_own_enable_and_the_common_one(fast_chip: Bench) -> None:
    """32.9.2 MSR ERRI: set with a flag of ESR whose enable is on; ERRIE lets it through; cleared by writing 1."""
    can_start(fast_chip)
    fast_chip.write(CAN1 + IER, 1 << 8 | 1 << 15)
    request(fast_chip, 0, 0x100)
    for n in range(1, 13):
        fast_chip.run(60 * BIT)
        assert not fast_chip.irq(CAN1_SCE), n
        sent(fast_chip, 0, ok=False)
        fast_chip.run(20 * BIT)
    assert fast_chip.read(CAN1 + MSR) & ERRI
    assert fast_chip.irq(CAN1_SCE)
    fast_chip.write(CAN1 + MSR, ERRI)
    assert not fast_chip.irq(CAN1_SCE)


def test_reset_bit_puts_it_to_sleep(fast_chip: Bench) -> None:
    """32.9.2 RESET: master reset, then sleep mode; FMP and MCR have their reset values."""
    can_start(fast_chip)
    accept_all(fast_chip)
    receive(fast_chip, 0x123)
    fast_chip.write(CAN1 + MCR, 1 << 15)
    fast_chip.run(5 * BIT)
    assert fast_chip.read(CAN1 + MCR) == 0x10002
    assert fast_chip.read(CAN1 + MSR) & SLAK
    assert fast_chip.read(CAN1 + RF0R) & FMP == 0


def test_a_pending_mailbox_cannot_be_written(fast_chip: Bench) -> None:
    """32.9.3: all TX registers are write protected while the mailbox is pending."""
    can_start(fast_chip)
    request(fast_chip, 0, 0x100, b"before")
    fast_chip.run(5 * BIT)
    fast_chip.write(CAN1 + TI0R + 8, 0)
    fast_chip.expect("mailbox")
    assert fast_chip.read(CAN1 + TI0R + 8) == int.from_bytes(b"befo", "little")


def test_an_active_filter_cannot_be_written(fast_chip: Bench) -> None:
    """32.9.4: a bank can be modified only while it is not active or FINIT is set."""
    can_start(fast_chip)
    accept_all(fast_chip)
    fast_chip.write(CAN1 + FILTER, 0xFFFFFFFF)
    fast_chip.expect("filter")
    assert fast_chip.read(CAN1 + FILTER) == 0
    fast_chip.write(CAN1 + FA1R, 0)
    fast_chip.write(CAN1 + FILTER, 0xFFFFFFFF)
    assert fast_chip.read(CAN1 + FILTER) == 0xFFFFFFFF


def test_a_remote_frame_keeps_its_flag_and_has_no_data(fast_chip: Bench) -> None:
    """32.9.3 RIR RTR; RDTR: DLC is 0 in the case of a remote frame request."""
    can_start(fast_chip)
    accept_all(fast_chip)
    receive(fast_chip, 0x123, b"four", remote=True)
    assert fast_chip.read(CAN1 + RI0R) == 0x123 << 21 | 2
    assert fast_chip.read(CAN1 + RI0R + 4) & 15 == 0
