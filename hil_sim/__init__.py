"""Simulator: the world, the boards and the wires between them, in one virtual time."""
