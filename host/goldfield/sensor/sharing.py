"""What the sensor that is read may send of its motion beside other boards on the same bus."""

from __future__ import annotations

from goldfield.errors import option
from goldfield.link.blocks import BLOCK_CHIPS
from goldfield.link.budget import SHARE, Carrier, Choice, choose, cycles_of_strongest, most_reported, pose_rate_Hz
from goldfield.link.buses import BusSource
from goldfield.sensor.dialogue import Parameters
from goldfield.sensor.receiver import Receiver
from goldfield.site import Site
from goldfield_protocol.parameters import PARAMETERS

POSE_BLOCKS = PARAMETERS["pose_blocks"].first


class Sharing:
    """Keeps count of the nodes that tell of their motion, and says what that leaves for the sensor.

    Parameters
    ----------
    receiver : Receiver
        Tells it to the user, once.
    site : Site
    bus : BusSource or None
        What a live sensor is read over; None: a recording.
    blocks : bool
        Whether blocks of chips are read, if they come.
    strongest : int, optional
        How many codes the sensor chooses in each cycle: its blocks would have now these, now others, and are not read.

    Attributes
    ----------
    choice : Choice or None
        What a live sensor is to send its blocks by, if they are read: sums or chips, or cycles only.
    moving : set of int
        The nodes that tell of their motion, that of the sensor among them.
    """

    def __init__(
        self, receiver: Receiver, site: Site, bus: BusSource | None, *, blocks: bool, strongest: int | None = None
    ) -> None:
        self.moving: set[int] = set()
        self._receiver = receiver
        self._site = site
        self._chip_s = site.cycle_s / site.chips
        self._bus = bus
        self._strongest = strongest
        self._codes = len(site.codes) if strongest is None else strongest
        self.choice: Choice | None = self._chosen(1) if blocks else None

    def _chosen(self, sensors: int) -> Choice | None:
        site = self._site
        if self._bus is None:
            return None
        if self._strongest is not None:
            return cycles_of_strongest(self._bus.line, self._strongest, site.chips, self._chip_s)
        return choose(self._bus.line, self._codes, site.chips, self._chip_s, sensors)

    def fitting(self) -> int | None:
        """Return how many codes a sensor that chooses them is to choose; None for one that reports the site's.

        They are fewer than were asked for if no more fit the link, which is told.
        """
        if self._bus is None:
            return self._strongest
        line, site = self._bus.line, self._site
        most = most_reported(line, self._codes, site.chips, self._chip_s)
        if most == self._codes:
            return self._strongest
        told = f"{self._codes} codes a cycle do not fit into {SHARE[line.link]:.0%} of {line}".replace("%", " %")
        if not most:
            self._receiver.tell_once(
                f"{told}, nor does one: let the boards speak faster, with goldfield nodes bit-rate"
            )
            return self._strongest
        if self._strongest is None:
            self._receiver.tell_once(f"{told}: let the sensor choose, with {option('strongest', most)}")
            return None
        self._receiver.tell_once(f"the sensor reports {most} of the strongest codes: {told}")
        return most

    def take(self, moving: set[int], node: int | None, parameters: Parameters) -> None:
        """Take note of who tells of its motion.

        Parameters
        ----------
        moving : set of int
        node : int or None
            The sensor's.
        parameters : mapping of int to int or float
            Those that it must have beside the site's codes.
        """
        self.moving = moving
        sensors = len(moving - {node}) + 1
        if self.choice is not None:
            self.choice = self._chosen(sensors)
        if self.choice is not None and (self.choice.carrier is not Carrier.BLOCKS or self.choice.reduced):
            self._receiver.tell_once(f"the sensor sends {self.choice.text}")
        every = int(parameters.get(POSE_BLOCKS, 0))
        if every and self._bus is not None:
            site, line = self._site, self._bus.line
            wanted_Hz = 1.0 / (every * BLOCK_CHIPS * self._chip_s)
            most_Hz = pose_rate_Hz(line, self._codes, site.chips, self._chip_s, sensors)
            if most_Hz < wanted_Hz:
                why = f"{sensors} sensors share {line}" if sensors > 1 else f"more do not fit on {line}"
                self._receiver.tell_once(f"the sensor sends {most_Hz:.0f} poses a second, not {wanted_Hz:.0f}: {why}")
