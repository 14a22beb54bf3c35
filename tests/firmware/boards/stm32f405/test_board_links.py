"""Serial port, CAN, clock fallback and watchdog of the flashable images in the emulator."""

from pathlib import Path

import pytest

from goldfield_protocol import FrameDecoder, decode, encode, encode_frame
from goldfield_protocol.parameters import build_page
from hil_sim import clib
from hil_sim.emulator.emulator import LIBRARY, Configuration, Emulator

OUT = Path(__file__).resolve().parents[4] / "build" / "firmware"
MS = 1_000_000_000
BYTE_PS = 5_000_000
ROLES = ["beacon", "sensor", "anchor"]


class Board:
    """A board with one node on its CAN bus, which acknowledges at once if there is a bus."""

    def __init__(self, image, *, page=None, bus=True, **configuration):
        self.serial, self.can, self.bus, self.pending = b"", [], bus, []
        self._ffi, _ = clib.load(LIBRARY, ["emulator/emulator.h"])
        edge = self._ffi.new("board_edge_t *")
        self._keep = [
            edge,
            self._ffi.callback("void(void *, unsigned, uint8_t, int64_t)", self._uart_out),
            self._ffi.callback("void(void *, unsigned, const board_frame_t *, int64_t)", self._can_request),
        ]
        edge.uart_out, edge.can_request = self._keep[1:]
        address = int(self._ffi.cast("uintptr_t", edge))
        self.emulator = Emulator(image, Configuration(**configuration), edge=address, parameter_page=page)
        self._operations = self._ffi.cast("board_operations_t *", self.emulator.operations)
        self._board = self._ffi.cast("board_t *", self.emulator.board)

    def _uart_out(self, _, uart, byte, _time_ps):
        assert uart == 3
        self.serial += bytes([byte])

    def _can_request(self, _, mailbox, frame, time_ps):
        self.pending.append((mailbox, frame.id, bytes(frame.data[0 : frame.length]), time_ps))

    def run(self, until_ms):
        """Run, and let the bus carry the requested frames in steps of 0.1 ms."""
        until_ps = int(until_ms * MS)
        while self.emulator.now_ps < until_ps:
            assert self.emulator.run(min(self.emulator.now_ps + MS // 10, until_ps)), self.emulator.report()
            requests, self.pending = self.pending, []
            for mailbox, identifier, data, _ in requests:
                if self.bus:
                    self.can.append((identifier, data))
                self._operations.can_sent(self._board, mailbox, self.bus, self.emulator.now_ps + MS // 20)

    def send_serial(self, data, at_ms):
        for i, byte in enumerate(data):
            self.emulator.uart_in(3, byte, 2_000_000, int(at_ms * MS) + (i + 1) * BYTE_PS)

    def send_can(self, identifier, data, at_ms):
        frame = self._ffi.new("board_frame_t *", {"id": identifier, "extended": True, "length": len(data)})
        frame.data[0 : len(data)] = list(data)
        self._operations.can_in(self._board, frame, int(at_ms * MS))

    def serial_messages(self):
        decoder = FrameDecoder()
        messages = [decode(f.identifier, f.data) for f in decoder.feed(self.serial)]
        assert decoder.bad_crc == decoder.malformed == decoder.overlong == 0
        return messages

    def can_messages(self):
        return [decode(*frame) for frame in self.can]


@pytest.fixture
def board():
    boards = []

    def make(role, **arguments):
        boards.append(Board(OUT / f"{role}.elf" if isinstance(role, str) else role, **arguments))
        return boards[-1]

    yield make
    for b in boards:
        b.emulator.close()


def values(messages):
    return [(m.index, m.signals["value_unsigned"]) for m in messages if m.name == "PARAM_VALUE"]


GET_NODE = encode("PARAM_GET", {"reserved": 0}, node=0, index=0)
GET_COUNT = encode("PARAM_GET", {"reserved": 0}, node=0, index=5)


@pytest.mark.parametrize("role", ROLES)
def test_parameter_page_and_questions_over_serial_and_can(board, role):
    b = board(role, page=build_page({"node": 77, "code_count": 3, "code_list": [1, 2, 3]}))
    b.run(30)
    b.send_serial(encode_frame(*GET_NODE), 30.1)
    b.send_can(*GET_COUNT, 30.2)
    b.run(60)
    assert values(b.serial_messages()) == [(0, 77)]
    assert values(b.can_messages()) == [(5, 3)]
    assert {m.node for m in b.serial_messages() + b.can_messages()} == {77}
    assert b.can_messages()[0].name == "HEARTBEAT"


@pytest.mark.parametrize("role", ROLES)
def test_serial_input_at_full_rate_loses_nothing(board, role):
    b = board(role)
    b.run(30)
    questions = 200 if role == "beacon" else 60
    burst = (encode_frame(*GET_NODE) + b"\x01garbage" * 3 + b"\0") * questions
    b.send_serial(burst, 30.0)
    b.run(90)
    assert len(values(b.serial_messages())) == questions


def test_without_a_can_bus_serial_runs_and_errors_are_counted(board):
    b = board("sensor", bus=False)
    b.run(1350)
    names = [m.name for m in b.serial_messages()]
    assert names.count("EPOCH") >= 12
    errors = [m.signals["value"] for m in b.serial_messages() if m.name == "COUNTER" and m.index == 2]
    assert errors
    assert errors[0] > 0


@pytest.mark.parametrize("role", ROLES)
def test_a_dead_crystal_falls_back_to_the_internal_oscillator(board, role):
    b = board(role, crystal_dead=True, internal_ppm=8000.0)
    b.run(1200)
    messages = b.serial_messages()
    assert [m.name for m in messages].count("HEARTBEAT") >= 2
    assert any(m.name == "COUNTER" and m.index == 7 for m in messages)
    assert any(m.name == ("EPOCH" if role == "sensor" else "DRIVE_STATUS") for m in messages)


@pytest.mark.parametrize("role", ROLES)
def test_a_hung_image_is_reset_by_the_watchdog(board, role, tmp_path):
    b = board(role)
    wait = b.emulator.symbols["hal_wait"] & ~1
    image = bytearray((OUT / f"{role}.elf").read_bytes())
    code = b.emulator.memory(wait, 16)
    assert image.count(code) == 1
    image[image.index(code) : image.index(code) + 2] = bytes.fromhex("fee7")  # Branch to itself.
    hung = tmp_path / "hung.elf"
    hung.write_bytes(image)
    b = board(hung)
    b.run(700)
    assert [m.name for m in b.serial_messages()].count("HEARTBEAT") == 2
