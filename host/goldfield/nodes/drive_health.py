"""How a coil driver fares: a ``DRIVE_HEALTH``, in words, with what to do."""

from __future__ import annotations

from dataclasses import dataclass

from goldfield_protocol.messages import Message, database

_NAMES: dict[int, object] = dict(
    database().get_message_by_name("DRIVE_HEALTH").get_signal_by_name("cause").choices or {}
)
NONE = "none"
CAUSES = {
    "over_current": "the coil's current was above the parameter over_current",
    "open_coil": "the coil's current stayed below what was asked: coil or cable is open",
    "driver": "the driver pulled its fault pin",
    "stale": "the coil's current was not measured any more",
    "excess": "the coil's current was far above what was asked, or fell faster than it did: the coil or turns of it "
    "are shorted, or the driver is broken",
    "overload": "the mean square of the coil's current was above the parameter rms_current",
    "coil_hot": "the coil was warmer than the parameter coil_hot, or its thermistor is not connected",
    "driver_hot": "the driver was warmer than the parameter driver_hot, or its thermistor is not connected",
    "supply_low": "the supply was below the parameter supply_low",
    "supply_high": "the supply was above the parameter supply_high",
    "clock": "the crystal stopped",
    "watchdog": "the firmware hung again and again while it drove, or its processor erred",
}
"""Why a drive was switched off, by the names that the DBC gives."""


@dataclass(frozen=True)
class DriveHealth:
    """How one channel of a beacon's drive fares.

    Attributes
    ----------
    cause : str
        Why it was switched off: a key of `CAUSES`, or ``"none"``.
    locked_out : bool
        Whether it was switched off so often in a row that only the loss of power brings it back.
    headroom_lost : bool
        Whether the driver does not make the current that is asked for: it falls short, or exceeds it.
    trips : int
        How often in a row it was switched off.
    wait_s, supply_V, coil_degC, driver_degC, rms_A, direct_A : float
        Time that it has yet to wait, s; what it measures: supply, V, temperatures, degC, root mean square of the
        current, A, and half the difference of the currents in both directions, A.
    """

    cause: str
    locked_out: bool
    headroom_lost: bool
    trips: int
    wait_s: float
    supply_V: float
    coil_degC: float
    driver_degC: float
    rms_A: float
    direct_A: float

    @property
    def reason(self) -> str | None:
        """Why it was switched off, in words; None if nothing keeps it off."""
        return None if self.cause == NONE else CAUSES.get(self.cause, f"cause {self.cause}")

    def remedy(self, node: int) -> str:
        """Return what brings the drive of a node back."""
        if self.locked_out:
            return f"it was switched off {self.trips} times in a row: mend it, then power the board off and on"
        return f"when that is mended: goldfield nodes clear {node}"


def health_of(message: Message) -> DriveHealth:
    """Return what a ``DRIVE_HEALTH`` says."""
    signals = message.signals
    number = int(signals["cause"])
    return DriveHealth(
        cause=str(_NAMES.get(number, number)),
        locked_out=bool(signals["locked_out"]),
        headroom_lost=bool(signals["headroom_lost"]),
        trips=int(signals["trips"]),
        wait_s=signals["wait"],
        supply_V=signals["supply"],
        coil_degC=signals["coil_temperature"],
        driver_degC=signals["driver_temperature"],
        rms_A=signals["rms"],
        direct_A=signals["direct"],
    )
