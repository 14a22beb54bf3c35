"""Run one image alone: ``python -m hil_sim.emulator IMAGE.elf --seconds S --uart N``."""

from __future__ import annotations

import argparse
import json
import sys
from pathlib import Path

from hil_sim.emulator.emulator import PICOSECONDS, Configuration, Emulator
from hil_sim.emulator.kept_flash import BadImageError
from hil_sim.options import add_cycles

SLICE_PS = PICOSECONDS // 100


def arguments(argv: list[str] | None) -> argparse.Namespace:
    """Parse the command line."""
    parser = argparse.ArgumentParser(
        prog="python -m hil_sim.emulator",
        description="Run an STM32F405 image. Exit codes: 0 done, 2 bad input, 3 the image faulted.",
    )
    parser.add_argument("image", help="ELF file, as flashed")
    parser.add_argument("--seconds", type=float, default=1.0, help="virtual time to run (default 1)")
    parser.add_argument("--uart", type=int, default=1, choices=range(1, 7), help="port whose bytes go to stdout")
    parser.add_argument("--stats", action="store_true", help="print counts as JSON on stderr")
    parser.add_argument("--parameters", metavar="FILE", help="parameter page, placed at 0x080E0000")
    parser.add_argument("--crystal-ppm", type=float, default=0.0, help="error of the crystal")
    parser.add_argument("--internal-ppm", type=float, default=0.0, help="error of the internal oscillator")
    parser.add_argument("--crystal-dead", action="store_true", help="the crystal never starts")
    parser.add_argument(
        "--tolerant",
        action="store_true",
        help="report violations and faults at the end instead of stopping; faults enter their handlers",
    )
    add_cycles(parser)
    parser.add_argument(
        "--probe", action="append", default=[], metavar="FUNCTION", help="count a function's instructions"
    )
    options = parser.parse_args(argv)
    if not 0 < options.seconds < 1e6:
        parser.error(f"--seconds is {options.seconds:g}; give a time between 0 and 1,000,000 s")
    return options


def execute(options: argparse.Namespace) -> int:
    """Run the image and return the exit code."""
    page = None
    if options.parameters is not None:
        try:
            page = Path(options.parameters).read_bytes()
        except OSError as error:
            raise BadImageError(f"parameter page {options.parameters} cannot be read: {error.strerror}") from error
    output = sys.stdout.buffer

    def uart_out(uart: int, byte: int, _time_ps: int) -> None:
        if uart == options.uart:
            output.write(bytes((byte,)))

    configuration = Configuration.with_cycles(
        options.cycles_per_instruction,
        crystal_ppm=options.crystal_ppm,
        internal_ppm=options.internal_ppm,
        crystal_dead=options.crystal_dead,
        strict=not options.tolerant,
        stop_at_fault=not options.tolerant,
    )
    with Emulator(options.image, configuration, parameter_page=page, uart_out=uart_out) as board:
        for function in options.probe:
            try:
                board.probe(function)
            except KeyError as error:
                raise BadImageError(str(error.args[0])) from error
        until = round(options.seconds * PICOSECONDS)
        alive = True
        while alive and board.now_ps < until:
            alive = board.run(min(board.now_ps + SLICE_PS, until))
            output.flush()
        statistics = board.statistics()
        if options.stats or options.probe:
            counts: dict[str, object] = dict(statistics.summary())
            if options.probe:
                counts["probes"] = {name: vars(probe) for name, probe in board.probes().items()}
            print(json.dumps(counts), file=sys.stderr)
        if not alive or statistics.violations or statistics.faults:
            print(board.report(), end="", file=sys.stderr)
            return 3
    return 0


def main(argv: list[str] | None = None) -> int:
    """Run the command; bad input is one sentence on stderr and exit code 2."""
    try:
        return execute(arguments(argv))
    except (BadImageError, FileNotFoundError) as error:
        print(f"hil_sim.emulator: {error}", file=sys.stderr)
        return 2


if __name__ == "__main__":
    sys.exit(main())
