"""The bit rates of the images' links: registers as the models decode them, bytes on the wire, frames on a bus."""

from __future__ import annotations

from itertools import pairwise
from pathlib import Path

import pytest

from goldfield_protocol import encode, encode_frame
from goldfield_protocol.parameters import build_page
from goldfield_protocol.rates import CAN_RATES, SERIAL_RATES
from hil_sim import clib
from hil_sim.emulator.emulator import LIBRARY
from tests.firmware.boards.stm32f405.test_board_links import GET_NODE, OUT, Board, values

CAN_ESR, CAN_BTR = 0x40006418, 0x4000641C
START_MS = {False: 5, True: 60}
BUS_HZ = {False: 42e6, True: 16e6}
"""Clock of the bus that both links are on (RM0090, figure 21): with the PLL, and without."""


class Wired(Board):
    """A board that keeps when its bytes have left, on a bus of some bit rate."""

    def __init__(self, image: Path, bus_bit_s: int = CAN_RATES[0], **page: int) -> None:
        self.ends_ps: list[int] = []
        super().__init__(image, page=build_page({"node": 7, **page}))
        self._operations.can_rate(self._board, bus_bit_s)

    def _uart_out(self, _, uart, byte, time_ps):
        super()._uart_out(_, uart, byte, time_ps)
        self.ends_ps.append(time_ps)

    def register(self, address: int) -> int:
        """What the core would read there."""
        ffi, library = clib.load(LIBRARY, ["emulator/machine_bench.h"])
        value = ffi.new("uint32_t *")
        assert library.machine_bench_read(ffi.cast("machine_t *", self.emulator.board), address, 4, value)
        return int(value[0])


@pytest.fixture(scope="module", params=[False, True], ids=["pll", "16 MHz"])
def slow(request):
    return request.param


@pytest.fixture
def image(slow, tmp_path):
    """A beacon's image, whose PLL locks or does not: the function that starts it says so at once."""
    if not slow:
        return OUT / "beacon.elf"
    whole = bytearray((OUT / "beacon.elf").read_bytes())
    board = Board(OUT / "beacon.elf")
    code = board.emulator.memory(board.emulator.symbols["run_on_pll"] & ~1, 24)
    board.emulator.close()
    assert whole.count(code) == 1
    whole[whole.index(code) : whole.index(code) + 4] = bytes.fromhex("00207047")  # return false
    path = tmp_path / "slow.elf"
    path.write_bytes(whole)
    return path


@pytest.mark.parametrize("index", range(len(CAN_RATES)))
def test_the_bits_on_can(image, slow, index):
    """BTR as RM0090, 32.9.2 has it: the rate to the bit, and a sample point of 75 to 87.5 % (CiA 601)."""
    board = Wired(image, CAN_RATES[index], can_rate=index)
    board.run(START_MS[slow])
    board.send_can(*GET_NODE, START_MS[slow] + 0.5)
    board.run(START_MS[slow] + 10)
    btr = board.register(CAN_BTR)
    divide, before, behind, jump = (btr & 0x3FF) + 1, (btr >> 16 & 15) + 1, (btr >> 20 & 7) + 1, (btr >> 24 & 3) + 1
    assert BUS_HZ[slow] / divide / (1 + before + behind) == CAN_RATES[index]
    assert 0.75 <= (1 + before) / (1 + before + behind) <= 0.875
    assert jump <= behind
    assert values(board.can_messages()) == [(0, 7)]
    assert "0 violations" in board.emulator.report()
    board.emulator.close()


@pytest.mark.parametrize(("own", "bus"), [(0, 1), (1, 0), (2, 3), (3, 2)])
def test_a_board_of_a_neighbour_rate_has_no_part_in_the_bus(own, bus):
    board = Wired(OUT / "beacon.elf", CAN_RATES[bus], can_rate=own)
    board.run(5)
    board.send_can(*GET_NODE, 5.5)
    board.run(9)
    assert board.can == []
    assert board.register(CAN_ESR) >> 24 > 0
    board.send_serial(encode_frame(*encode("PARAM_GET", {"reserved": 0}, node=0, index=58)), 9.1)
    board.run(20)
    assert values(board.serial_messages()) == [(58, own)]
    board.emulator.close()


WORST_PER_MILLE = {False: (0.0, 9.4, 1.7, 1.2), True: (0.0, 21.3, 8.1, 0.9)}
"""What serial.c says: with the PLL less than 10, which an adapter takes; without, 921,600 baud may not do."""


@pytest.mark.parametrize("index", range(len(SERIAL_RATES)))
def test_the_bytes_on_serial(image, slow, index):
    """The first heartbeat, which goes by polling, and an answer, which goes by DMA, back to back."""
    baud = SERIAL_RATES[index]
    board = Wired(image, serial_rate=index)
    board.run(START_MS[slow] + 5)
    byte_ps = 10e12 / baud
    for i, byte in enumerate(encode_frame(*GET_NODE)):
        board.emulator.uart_in(3, byte, baud, board.emulator.now_ps + round((i + 1) * byte_ps))
    board.run(START_MS[slow] + 30)
    messages = board.serial_messages()
    assert messages[0].name == "HEARTBEAT"
    assert values(messages) == [(0, 7)]
    apart = [after - before for before, after in pairwise(board.ends_ps)]
    answer = apart[-len(board.serial[:-1].rsplit(b"\0", 1)[1]) :]
    assert max(answer) - min(answer) <= 2
    assert abs(answer[0] / byte_ps - 1) * 1000 <= WORST_PER_MILLE[slow][index]
    assert min(apart) >= answer[0] - 2
    assert "0 violations" in board.emulator.report()
    board.emulator.close()


@pytest.mark.long
def test_a_sensor_that_streams_into_the_slowest_line_goes_on(tmp_path):
    """Chips are 14 times what it carries. 20 ms of bytes wait in the board, so a heartbeat is not late by more."""
    board = Wired(OUT / "sensor.elf", serial_rate=3, stream=1)
    board.run(2300)
    messages = board.serial_messages()
    names = [m.name for m in messages]
    assert names.count("HEARTBEAT") == 3
    assert names.count("RESET_REPORT") == 2
    assert names.count("EPOCH") >= 20
    assert names.count("CHIP") > 500
    busy = (board.ends_ps[-1] - board.ends_ps[0]) / (len(board.ends_ps) - 1) / (10e12 / SERIAL_RATES[3])
    assert busy < 1.06
    board.emulator.close()
