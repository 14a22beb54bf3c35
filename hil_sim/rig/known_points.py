"""Known points as a table for ``goldfield survey``: the cycles in which a walk stands still at one of them."""

from __future__ import annotations

from hil_sim.rig.truth import Truth
from hil_sim.scenario import CHIP_PERIOD_S, Scenario

HEADER = "epoch,x_m,y_m,z_m,sigma_m"


def point_row(scenario: Scenario, truth: Truth) -> str | None:
    """Return a cycle's row of the table: what was measured of its place, not the truth.

    Returns
    -------
    row : str or None
        None: the sensor is at no known point for the whole of the cycle.
    """
    half_s = 0.5 * scenario.chips * CHIP_PERIOD_S
    for visit in scenario.visits:
        if visit.arrival_s <= truth.time_s - half_s and truth.time_s + half_s <= visit.departure_s:
            mark = visit.mark
            return ",".join([str(truth.cycle), *(f"{value:.6f}" for value in (*mark.position_m, mark.sigma_m))])
    return None
