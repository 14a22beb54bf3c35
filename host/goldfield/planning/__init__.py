"""Planning: how well a sensor can be located everywhere in a room, before anything is installed in it.

`plan` turns a `Request` (a site, the points of a `Grid`, `Settings`) into `Maps`: at each point the Cramer-Rao bound
on position and attitude, the protection level, ambiguity, dilution, the beacons that matter most, and for the whole
room which beacons may share a code.
"""

from goldfield.planning.grid import Grid
from goldfield.planning.maps import Maps
from goldfield.planning.request import Request, Settings
from goldfield.planning.spreading import plan

__all__ = ["Grid", "Maps", "Request", "Settings", "plan"]
