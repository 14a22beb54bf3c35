"""Something of a beacon stops while it drives its coil: the coil goes off within the watchdog's time.

After the restart the board says what stood still.

The image is the application's and the board's own code, with a main that stops one thing once.
"""

import pytest

from goldfield.nodes.last_reset import PARTS
from goldfield_protocol import FrameDecoder, decode
from tests.firmware import host_rig
from tests.firmware.boards.stm32f405.fault_images import (
    ADC,
    CAN1_RX0,
    CAN1_RX1,
    CAN1_TX,
    CHIP,
    DMA1_STREAM1,
    DMA1_STREAM3,
    DMA2,
    DMA2_STREAM1,
    HANG_ALWAYS,
    HANG_INTERRUPT,
    HANG_MAIN,
    HANG_MASKED,
    MASK_INTERRUPT,
    NOTHING,
    PLANNED,
    RUNNING,
    STOP_ADC,
    STOP_BURSTS,
    STOP_STREAM,
    STOP_TIMER,
    TIM1_BRK,
    TIM7,
    TIM8_CC,
    fault_page,
    off_after,
)
from tests.firmware.host_rig import BEACON, MS, PIN_ENABLE, SECOND, Coil, beacon

INJECT, WATCHDOG, BLOCK = 700 * MS, 500 * MS, 4 * MS
PERIOD = 15 * MS  # what moved just before it stopped counts once more
WATCHDOG_CAUSE = 4
CONVERTER_OVERRUNS = 6
STALE, WATCHDOG_TRIP = 4, 12  # firmware/core/drive/cause.h


@pytest.fixture
def driving(images, monkeypatch):
    boards = []

    def make(kind, which=0, role="beacon", strict=True, amplitude=5.0):
        page = fault_page(kind, which, INJECT, amplitude=amplitude)
        monkeypatch.setitem(host_rig.IMAGES, BEACON, str(images[role]))
        boards.append(beacon(Coil(), parameters=page, emulated=True, strict=strict))
        if kind != HANG_ALWAYS:
            boards[-1].run(INJECT - MS)
            assert boards[-1].level[PIN_ENABLE] == (amplitude > 0.0)
        return boards[-1]

    yield make
    for board in boards:
        board.close()


def was_injected(board):
    address = board.emulator.symbols["injected"]
    return int.from_bytes(board.emulator.memory(address, 4), "little") != 0


def last_report(board):
    """Return the reports of a restart: cause, and what stood still."""
    frames = FrameDecoder().feed(bytes(byte for _, byte in board.serial))  # a reset tears a frame
    messages = (decode(frame.identifier, frame.data) for frame in frames)
    found = [m.signals for m in messages if m.name == "RESET_REPORT" and m.index == 0]
    assert len(found) == 2, "the board has not restarted once"
    stalled = int(found[1]["stalled"])
    return found[1]["cause"], {part for bit, part in enumerate(PARTS) if stalled >> bit & 1}


def health(board):
    """Return why the drive is off, by the latest word of the board, and whether for ever."""
    frames = FrameDecoder().feed(bytes(byte for _, byte in board.serial))
    messages = (decode(frame.identifier, frame.data) for frame in frames)
    told = [m.signals for m in messages if m is not None and m.name == "DRIVE_HEALTH"][-1]
    return {key: int(told[key]) for key in ("cause", "locked_out")}


def assert_restart(board, stalled):
    assert_board_restarts(board, stalled)
    off = [time for time in board.edges(PIN_ENABLE, False) if time > INJECT]
    assert off[0] <= INJECT + WATCHDOG + PERIOD + 2 * BLOCK


def assert_board_restarts(board, stalled):
    board.run(INJECT + 4 * BLOCK)
    assert was_injected(board)
    board.run(INJECT + WATCHDOG + PERIOD + 30 * MS)
    cause, still = last_report(board)
    assert cause == WATCHDOG_CAUSE
    assert still >= stalled
    assert bool(still) == bool(stalled)


def test_a_board_of_which_nothing_stops_goes_on(driving):
    board = driving(NOTHING)
    board.run(2000 * MS)
    assert board.level[PIN_ENABLE]
    assert [m.signals["cause"] for m in board.messages("RESET_REPORT") if m.index == 0] == [0]


def test_a_main_loop_that_hangs(driving):
    assert_restart(driving(HANG_MAIN), set())


@pytest.mark.parametrize("irq", [ADC, CAN1_TX, CAN1_RX0, CAN1_RX1, TIM1_BRK, TIM8_CC])
def test_a_handler_that_hangs_above_the_coil_current_ends_the_drive_two_chips_later(driving, irq):
    """The main loop does not run any more, and nobody notes anything."""
    board = driving(HANG_INTERRUPT, irq)
    assert_restart(board, set())
    assert off_after(board) <= RUNNING * CHIP


@pytest.mark.parametrize("irq", [DMA1_STREAM1, DMA1_STREAM3, DMA2_STREAM1])
def test_a_handler_that_hangs_below_ends_the_drive_where_the_plan_ends(driving, irq):
    """Coil currents are measured on, and nobody plans: the drive went on with old chips until the watchdog."""
    board = driving(HANG_INTERRUPT, irq)
    assert_restart(board, set())
    assert off_after(board) <= (PLANNED + RUNNING) * CHIP


def test_a_drive_that_a_hanging_handler_ended_stays_off_over_the_restart(driving):
    board = driving(HANG_INTERRUPT, DMA2_STREAM1)
    board.run(INJECT + 2500 * MS)
    assert len(board.edges(PIN_ENABLE, True)) == 1
    board.serial = board.serial[len(board.serial) // 2 :]  # Behind the frame that the reset has torn.
    assert health(board) == {"cause": STALE, "locked_out": 0}


@pytest.mark.slow  # tests/firmware/services/test_protection.py has a hung main loop on a host board
def test_a_main_loop_that_hangs_whenever_the_drive_is_on_is_locked_out(driving):
    """Each restart by the watchdog waits twice as long as the one before, and the fifth for ever."""
    board = driving(HANG_ALWAYS)
    board.run(24 * SECOND)
    on, off = board.edges(PIN_ENABLE, True), board.edges(PIN_ENABLE, False)
    assert len(on) == len(off) == 5
    assert all(end - begin <= WATCHDOG + PERIOD for begin, end in zip(on, off, strict=True))
    waits = [begin - end for begin, end in zip(on[1:], off[:-1], strict=True)]
    assert all(SECOND << n <= wait <= (SECOND << n) + 300 * MS for n, wait in enumerate(waits))
    board.serial = [(time, byte) for time, byte in board.serial if time > off[-1] + BLOCK]
    assert health(board) == {"cause": WATCHDOG_TRIP, "locked_out": 1}


@pytest.mark.parametrize("role", ["beacon", "anchor"])
@pytest.mark.parametrize(("kind", "irq"), [(HANG_INTERRUPT, TIM7), (HANG_MASKED, 0)])
def test_a_processor_that_serves_no_interrupt_loses_the_drive_in_hardware(driving, kind, irq, role):
    """Nothing runs but timers and DMA: the drive went on until the watchdog, with plans that nobody renewed."""
    board = driving(kind, irq, role=role)
    assert_restart(board, set())
    assert off_after(board) <= RUNNING * CHIP


def test_a_processor_that_a_debugger_halts_loses_the_drive_and_no_watchdog_strikes(driving):
    """The coil went on with old chips, and the watchdog, which stands still then, did not end it."""
    board = driving(NOTHING, strict=False)
    board.emulator.debug_halt(True, INJECT)
    board.run(INJECT + 2 * SECOND)
    [off] = board.edges(PIN_ENABLE, False)
    assert INJECT < off <= INJECT + RUNNING * CHIP
    board.emulator.debug_halt(False, INJECT + 2 * SECOND)
    board.run(INJECT + 4 * SECOND)
    assert [m.signals["cause"] for m in board.messages("RESET_REPORT") if m.index == 0] == [0]
    assert len(board.edges(PIN_ENABLE, True)) == 1
    assert health(board)["cause"] == STALE


def test_a_drive_that_the_fuse_ended_stays_off_over_the_restart(driving):
    """The watchdog restarts a board that was on, as far as it knows: that counts, and the drive waits."""
    board = driving(HANG_MASKED)
    board.run(INJECT + WATCHDOG + PERIOD + 900 * MS)
    assert len(board.edges(PIN_ENABLE, True)) == 1
    board.run(INJECT + 2500 * MS)
    assert len(board.edges(PIN_ENABLE, True)) == 2


@pytest.mark.parametrize(
    ("irq", "part", "chips"), [(ADC, "coil currents", RUNNING), (DMA2_STREAM1, "blocks", PLANNED + RUNNING)]
)
def test_an_interrupt_that_comes_no_more(driving, irq, part, chips):
    """Nobody fetches a conversion before the next, which the chip's manual forbids."""
    board = driving(MASK_INTERRUPT, irq, strict=False)
    assert_restart(board, {part})
    assert off_after(board) <= chips * CHIP


def test_currents_that_end_while_the_drive_is_off_leave_the_main_loop_its_time(driving):
    """The fuse burns down with the bridges off: its interrupt, which came for ever, would keep main from noting it."""
    board = driving(MASK_INTERRUPT, ADC, strict=False, amplitude=0.0)
    assert_board_restarts(board, {"coil currents"})
    assert not board.edges(PIN_ENABLE, True)


def test_a_serial_port_that_sends_no_more(driving):
    """It is noticed from the first message on that is to leave."""
    board = driving(MASK_INTERRUPT, DMA1_STREAM3)
    board.run(INJECT + 100 * MS)  # A beacon tells its status once a cycle.
    asked = next(time for time, _ in board.serial if time > INJECT)
    board.run(asked + WATCHDOG + PERIOD + 100 * MS)
    assert last_report(board) == (WATCHDOG_CAUSE, {"serial link"})
    off = next(time for time in board.edges(PIN_ENABLE, False) if time > INJECT)
    assert off <= asked + WATCHDOG + PERIOD + 2 * BLOCK


@pytest.mark.parametrize(("timer", "parts"), [(4, {"coil currents"}), (2, set())])
def test_a_timer_that_stops(driving, timer, parts):
    """Timer 2 is the clock, without which nothing is noted either."""
    assert_restart(driving(STOP_TIMER, timer), parts)


@pytest.mark.parametrize("timer", [1, 8])
def test_a_timer_of_the_chips_that_stops(driving, timer):
    """No current can be told to belong to a chip: the coil goes off as with the others, and the board restarts."""
    board = driving(STOP_TIMER, timer)
    assert_restart(board, {"coil currents"})
    assert off_after(board) <= (RUNNING + 1) * CHIP


def test_the_timer_of_the_edges_that_stops_switches_the_coil_off_for_good(driving):
    """The other timers go on, so everything moves, if slowly: the board stays up and tells why its coil is off."""
    board = driving(STOP_TIMER, 3)
    board.run(INJECT + 1500 * MS)
    assert was_injected(board)
    assert off_after(board) <= (RUNNING + 1) * CHIP  # one more may have had its edges
    assert not [time for time in board.edges(PIN_ENABLE, True) if time > INJECT]
    assert board.messages("DRIVE_HEALTH")[-1].signals["cause"] == STALE


def test_the_stream_of_the_edges_that_stops(driving):
    """A stream that is switched off raises its flag.

    In every other block nobody clears it: the handler comes for ever, and main no more. In the others the block is
    taken for over, and none comes any more.
    """
    board = driving(STOP_STREAM, DMA2 + 1)
    board.run(INJECT + 4 * BLOCK)
    assert was_injected(board)
    board.run(INJECT + WATCHDOG + PERIOD + 50 * MS)
    assert off_after(board) <= (RUNNING + 1) * CHIP
    cause, still = last_report(board)
    assert cause == WATCHDOG_CAUSE
    assert still in (set(), {"blocks"})


def test_a_converter_that_stops(driving):
    assert_restart(driving(STOP_ADC, 1, strict=False), {"coil currents"})


def test_bursts_that_nothing_triggers_are_started_again(driving):
    board = driving(STOP_BURSTS, 1, role="anchor")
    board.run(INJECT + 1500 * MS)
    assert was_injected(board)
    assert board.level[PIN_ENABLE]
    assert [m.signals["value"] for m in board.messages("COUNTER") if m.index == CONVERTER_OVERRUNS] == [1, 1]


def test_a_stream_of_samples_that_stops_is_started_again(driving):
    board = driving(STOP_STREAM, DMA2 + 0, role="anchor", strict=False)
    board.run(INJECT + 1500 * MS)
    assert board.level[PIN_ENABLE]
    assert [m.signals["value"] for m in board.messages("COUNTER") if m.index == CONVERTER_OVERRUNS] == [1, 1]
