"""What each board on a link says of itself, as records for JSON."""

from __future__ import annotations

from typing import Any

from goldfield.link.requests import Value
from goldfield.nodes.clock_quality import ClockQuality
from goldfield.nodes.roster import Node, Roster
from goldfield.view.records import number
from goldfield_protocol.parameters import counter_name, label_of


def clock_record(clock: ClockQuality) -> dict[str, Any]:
    """Return how a board has the time, for JSON."""
    return {
        "source": clock.source,
        "locked": clock.locked,
        "rank": clock.rank,
        "leader": clock.leader,
        "age_s": number(clock.age_s),
        "rate_ppm": number(clock.rate_ppm),
        "error_s": None if clock.error_s is None else number(clock.error_s),
    }


def board_record(node: Node) -> dict[str, Any]:
    """Return what a board says of itself for JSON; None is what it has not told."""
    health = node.health.get(0)
    return {
        "role": node.role,
        "state": node.state,
        "version": node.version,
        "locked": node.locked,
        "phase_s": None if node.phase_s is None else number(node.phase_s),
        "clock": None if node.clock is None else clock_record(node.clock),
        "temperature_degC": None if node.temperature_degC is None else number(node.temperature_degC),
        "coil_degC": None if health is None else number(health.coil_degC),
        "driver_degC": None if health is None else number(health.driver_degC),
        "supply_V": None if health is None else number(health.supply_V),
        "complaints": [text for _, drive in sorted(node.drives.items()) for text in drive.complaints],
        "counters": {counter_name(index): count for index, count in sorted(node.counters.items()) if count},
    }


def parameters_record(roster: Roster) -> dict[str, Any]:
    """Return every board with the parameters that it has told, by number and name, for JSON."""
    return {
        "nodes": {
            str(node.number): board_record(node)
            | {"parameters": {label_of(index): _value(value) for index, value in sorted(node.parameters.items())}}
            for node in sorted(roster.nodes.values(), key=lambda node: node.number)
        }
    }


def _value(value: Value | None) -> Value | None:
    return number(value) if isinstance(value, float) else value
