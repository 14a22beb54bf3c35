"""Serial port, timers and their interrupts: the same program notes the same on the emulator and on QEMU's STM32F405.

QEMU's models (netduinoplus2) are somebody else's reading of RM0090. They have no baud rate, no overrun, no trigger and
one clock, and that of the serial port raises no interrupt but that of a received byte (7.2): what they can say is which
flag is set and cleared by what, and which interrupt it raises.
"""

import subprocess
from pathlib import Path

from hil_sim.emulator import Configuration, Emulator
from tests.hil_sim.emulator import oracle

USART1, BAUD = 1, 115_108  # 16 MHz divided by 0x8B
SENT_BY_TEST = b"\x00\x7f\x80\xff"
EXPECTED = b"abcdex" + b"R" * len(SENT_BY_TEST) + b"E"


def noted_by_emulator(image: Path) -> tuple[list[int], bytes]:
    """Run the program on a board; return its notes and what it sent."""
    sent, bytes_left = bytearray(), list(SENT_BY_TEST)

    def hear(uart: int, byte: int, time_ps: int) -> None:
        assert uart == USART1
        sent.append(byte)
        if byte == ord("R"):
            board.uart_in(USART1, bytes_left.pop(0), BAUD, time_ps + oracle.MILLISECOND)

    configuration = Configuration(strict=False, stop_at_fault=False)
    with Emulator(image, configuration, uart_out=hear) as board:
        return oracle.run_on_emulator(board), bytes(sent)


def noted_by_qemu(image: Path) -> tuple[list[int], bytes]:
    """Run the program on QEMU, with its USART1 at this process; return its notes and what it sent."""
    command = ["qemu-system-arm", "-M", "netduinoplus2", "-display", "none", "-monitor", "none", "-serial", "stdio"]
    command += ["-semihosting-config", "enable=on,target=native", "-kernel", str(image)]
    command += ["-device", "loader,addr=0x2001F000,data=0x51454D55,data-len=4"]
    sent, bytes_left = bytearray(), list(SENT_BY_TEST)
    with subprocess.Popen(command, cwd=image.parent, stdin=subprocess.PIPE, stdout=subprocess.PIPE) as process:
        assert process.stdin is not None
        assert process.stdout is not None
        while byte := process.stdout.read(1):
            sent += byte
            if byte == b"R":
                process.stdin.write(bytes([bytes_left.pop(0)]))
                process.stdin.flush()
    assert process.returncode == 0
    return oracle.words((image.parent / "results.bin").read_bytes()), bytes(sent)


def test_serial_port_and_timers_equal_qemu(tmp_path: Path) -> None:
    image = oracle.build(tmp_path, oracle.PROGRAMS / "board_parts.c")
    ours, sent = noted_by_emulator(image)
    theirs, sent_there = noted_by_qemu(image)
    assert [hex(value) for value in ours] == [hex(value) for value in theirs]
    assert len(ours) > 50
    assert sent == sent_there == EXPECTED
