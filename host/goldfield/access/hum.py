"""What the hum of the mains leaves in fields that were separated by codes, and does not average out.

A sensor that sends only the sums of its cycles cannot tell the mains from codes: of a hum of amplitude a, each code
keeps about a sqrt(2 / N), one more and another less. That is no noise. A cycle of degree 10 is five periods of 50 Hz to
20 ppm, so that the hum begins each cycle at nearly the same phase, and what it leaves in a beacon's field stays the
same for many seconds, wherever the sensor goes: a history of cycles would take it for a beacon that was moved.
"""

from __future__ import annotations

import numpy as np

from goldfield.access.nuisance import mains
from goldfield.access.waveform import beacon_template
from goldfield.site import Site
from goldfield.types import FloatArray


def hum_deviations(site: Site) -> FloatArray:
    """Return the standard deviation that the site's hum gives each component of each beacon's field, T, shape (n,).

    The phase is unknown and every one is as likely. Codes are nearly independent of each other and of a constant, so
    that it is the same whichever beacons are separated together.
    """
    sensor = site.sensor
    if sensor.hum_T == 0.0:
        return np.zeros(len(site.beacons))
    waves = mains(site.chips, site.chip_period_s, sensor.hum_Hz).columns
    templates = (beacon_template(site, beacon) for beacon in site.beacons)
    return sensor.hum_T * np.array([_left(template - template.mean(), waves) for template in templates])


def _left(template: FloatArray, waves: FloatArray) -> float:
    """Return what waves of one, in quadrature, leave in a beacon's amplitude."""
    return float(np.linalg.norm(template @ waves) / (template @ template))
