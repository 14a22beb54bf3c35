"""From a sensor's report of a cycle to the field of each beacon: separated, the ambient field's ramp taken out."""

from __future__ import annotations

from goldfield.access.epoch import EpochSeparator
from goldfield.access.motion_repair import MotionRepair
from goldfield.access.sweep import SweepRepair
from goldfield.link.reports import Report
from goldfield.site import Site
from goldfield.types import Fields


class Separation:
    """Separates the reports of one sensor, in the order of their cycles.

    Parameters
    ----------
    site : Site
    of_instants : bool
        Whether each cycle's fields are to be those of its middle (`MotionRepair`): not for trackers, whose model has
        the motion during the cycle.

    Raises
    ------
    UserError
        If the site's codes cannot be separated.
    """

    def __init__(self, site: Site, *, of_instants: bool) -> None:
        self._chips = site.chips
        self._separator = EpochSeparator(site)
        self._sweep = SweepRepair(site)
        self._motion = MotionRepair(site) if of_instants else None

    def fields(self, report: Report, strongest: int = 0) -> Fields:
        """Return the fields of the next cycle; beacons whose message did not arrive are left out.

        With ``strongest`` above 0 the sensor has chosen the codes of the report, at most so many.
        """
        mean_T = report.offset_T if report.chips == self._chips else None  # with chips lost the mean tells no ramp
        fields = self._sweep.repaired(self._separator.fields(report, strongest), mean_T)
        return fields if self._motion is None else self._motion.repaired(fields)
