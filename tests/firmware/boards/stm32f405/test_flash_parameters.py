"""``make flash`` takes every parameter of a board."""

import re
from pathlib import Path

from goldfield_protocol.parameters import PARAMETERS

MAKEFILE = Path(__file__).resolve().parents[4] / "firmware" / "boards" / "stm32f405" / "board.mk"


def test_every_parameter_can_be_flashed():
    text = MAKEFILE.read_text().replace("\\\n", " ")
    names = re.search(r"STM32_PARAMETERS := \$\(foreach name,([A-Z_ \t]*),", text)[1].split()
    assert sorted(names) == sorted(name.upper() for name in PARAMETERS)
