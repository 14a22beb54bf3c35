"""What a heartbeat says a node is and does: roles and states, by the names that the DBC gives them."""

from __future__ import annotations

from goldfield_protocol.messages import database


def _names(signal: str) -> dict[int, str]:
    found = database().get_message_by_name("HEARTBEAT").get_signal_by_name(signal).choices
    assert found is not None
    return {int(number): str(name) for number, name in found.items()}


ROLES = _names("role")
"""What a node is, by the number in its heartbeat; all of its two bits have a name."""
STATES = _names("state")
"""What a node does, by the number in its heartbeat."""

_ROLE_OF, _STATE_OF = ({name: number for number, name in names.items()} for names in (ROLES, STATES))
ROLE_BEACON, ROLE_SENSOR, ROLE_ANCHOR = (_ROLE_OF[name] for name in ("beacon", "sensor", "anchor"))
STATE_STARTING, STATE_FAULT, STATE_CLOCK_FALLBACK = (
    _STATE_OF[name] for name in ("starting", "fault", "clock_fallback")
)
DRIVING = (ROLE_BEACON, ROLE_ANCHOR)
"""Roles of the boards that drive coils."""
