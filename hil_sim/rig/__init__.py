"""The rig: boards, world, sync wire, CAN and serial in one virtual time; `Rig` is the door."""

from hil_sim.rig.known_points import point_row
from hil_sim.rig.rig import SENSOR, Frame, Rig
from hil_sim.rig.truth import Truth

__all__ = ["SENSOR", "Frame", "Rig", "Truth", "point_row"]
