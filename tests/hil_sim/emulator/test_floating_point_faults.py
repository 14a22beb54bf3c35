"""Floating-point loads and stores under the memory protection unit.

ARMv7-M manual: VLDR, VLDM, VPOP, VSTR, VSTM and VPUSH make word accesses (A7.7.235 and on), each of which the unit
judges (B3.5.3); MMFAR has the address that was refused (B3.2.18). A load that is refused has not written its register
(VLDR writes it behind all its accesses), nor the base (B1.5.6: the instruction is abandoned and done again).
"""

from collections.abc import Iterator

import pytest

from hil_sim.emulator import Configuration, Emulator
from tests.hil_sim.emulator import oracle

MEMORY, DATA, RCC = 4, 0x82, 0x40023800
KNOWN = [0x3F800000 + i for i in range(8)]
"""What s0 to s7 hold before each instruction."""
ARRAY = [0x40000000 + i for i in range(768)]
LOADS = ("load_single", "load_double", "load_several", "load_pairs", "load_down", "load_core")
STORES = ("store_single", "store_double", "store_several", "store_down")


@pytest.fixture(scope="module")
def board(tmp_path_factory: pytest.TempPathFactory) -> Iterator[tuple[list[int], dict[str, int]]]:
    image = oracle.build(tmp_path_factory.mktemp("floating"), oracle.PROGRAMS / "floating_faults.c")
    with Emulator(image, Configuration(stop_at_fault=False)) as emulator:
        yield oracle.run_on_emulator(emulator), emulator.symbols


def test_what_the_unit_refuses_is_abandoned_with_its_first_address(board: tuple[list[int], dict[str, int]]) -> None:
    told, symbols = board
    notes, middle = iter(told), symbols["guarded"] + 1024

    def refused(name: str, base: int, address: int, *, at: str = "", kept: int = 0) -> None:
        """Registers from number ``kept`` on are as before."""
        expected = [MEMORY, DATA, 0, address, symbols[at or f"at_{name}"] & ~1, base, *KNOWN]
        found = [next(notes) for _ in expected]
        found[6 : 6 + kept] = KNOWN[:kept]
        assert found == expected, (name, hex(base))

    def allowed(name: str, *registers: int) -> None:
        expected = [*registers, *KNOWN[len(registers) :]]
        assert [next(notes) for _ in expected] == expected, name

    for address in (middle, RCC):
        for name in (*LOADS, *STORES):
            refused(name, address + (16 if "down" in name else 0), address)
    refused("load_several", middle - 8, middle, kept=4)  # Those in the list are unknown: two were loaded.
    refused("load_down", middle + 1032, middle + 1016)
    allowed("load_several", *ARRAY[252:256])
    refused("store_several", middle - 8, middle)
    allowed("load_single", ARRAY[256])
    refused("store_single", middle, middle)
    # The words before the region were written, those in it were not.
    assert [next(notes) for _ in range(12)] == [*ARRAY[252:254], *KNOWN[:2], *ARRAY[256:264]]
    refused("pop", middle, middle, at="at_vpop")
    assert list(notes) == [middle]  # The stack pointer.
