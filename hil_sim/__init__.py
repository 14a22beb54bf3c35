"""Simulator: the world, the boards and the wires between them, in one virtual time."""

KINDS = ("emulated", "host")
"""Kinds of boards: the ARM image in the emulator, or the same firmware compiled for this machine."""
NO_CAN = "none"
"""The CAN channel of a bench whose bus nobody else sees."""
CYCLES_BY_CLASS = "m4"
"""In place of a number of cycles per instruction: costs by class of instruction, flash and buses counted."""
MOST_CYCLES = 100.0
"""Largest number of cycles per instruction; the least is 1."""
LONGEST_S = 5e6
"""Virtual time in which a run ends by itself: its picoseconds have 63 bits, which hold 106 days."""
