"""A bench through which something of metal is carried: an event of the rig brings a body, and this one takes it on."""

from __future__ import annotations

from dataclasses import dataclass, fields

import numpy as np

from hil_sim.scenario import Bring, Scenario
from hil_sim.world.ball import Ball
from hil_sim.world.metal import Body
from hil_sim.world.sheet import Sheet
from tests.campaign.stage import HIGH_M, LOW_M, Kind

STEP_S = 0.1
"""The body stands still for so long, and is then a step further: 3 cm at a walk of 0.3 m/s."""
NOWHERE = Sheet(np.array([0.0, 0.0, 1e6]), np.array([0.0, 0.0, 1.0]), 0.1)
"""What the events name: the rig hands the paths over anew at each, and asks `Carried` which metal there is."""


@dataclass(frozen=True, eq=False)
class Carried(Scenario):
    """A scenario with a body that is carried.

    Attributes
    ----------
    carried : tuple of (float, Body or None)
        From which virtual time on which body is there.
    """

    carried: tuple[tuple[float, Body | None], ...] = ()

    def metal_at(self, time_s: float) -> tuple[Body, ...]:
        """Return the metal that is there at a virtual time."""
        latest = [body for since_s, body in self.carried if since_s <= time_s]
        return (*self.metal, *(body for body in latest[-1:] if body is not None))


def walked(scenario: Scenario, carried: list[tuple[float, Body | None]]) -> Carried:
    """Return the scenario with a body that is carried so."""
    events = (*scenario.events, *(Bring(since_s, NOWHERE) for since_s, _ in carried))
    ours = {field.name: getattr(scenario, field.name) for field in fields(Scenario)}
    return Carried(**{**ours, "events": events, "carried": tuple(carried)})


def ball(material: str, radius_m: float, distance_m: float) -> Kind:
    """Return the kind by which a ball is carried along a side of the walked room, there and away again."""

    def plan(scenario: Scenario, at_s: float, until_s: float, random: np.random.Generator) -> Scenario:
        begin = np.array([LOW_M[0] - distance_m, LOW_M[1], float(random.uniform(0.7, 1.1))])
        along = np.array([0.0, (HIGH_M[1] - LOW_M[1]) / (until_s - at_s), 0.0])
        times_s = np.arange(at_s, until_s, STEP_S)
        steps: list[tuple[float, Body | None]] = [
            (float(time_s), Ball(begin + (time_s - at_s) * along, radius_m, material)) for time_s in times_s
        ]
        return walked(scenario, [*steps, (until_s, None)])

    return Kind("surroundings", f"{material} ball of {2 * radius_m:g} m is carried past", plan=plan)


CARRIED = [ball("iron", 0.12, 0.2), ball("conductor", 0.12, 0.2)]
