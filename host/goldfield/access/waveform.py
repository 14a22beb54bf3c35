"""Templates: what each beacon adds to the samples of a cycle for a field of one.

Sample t is taken at the end of chip t. Without coil rise the template is the drive itself, in parts of the beacon's
current; `goldfield.access.rise` filters it with the time constant of the coil.

- CDMA: Gold codes. Several on one beacon share its current equally. A code with ``hold`` h lasts h chips for each of
  its own; it begins anew with every cycle. The drive may be any offset plus these: a constant field is no beacon's.
- TDMA: +1 during the beacon's slot of ``N // slots`` chips, else 0. Chips of no beacon are quiet and show the ambient
  field; those that are left over after the last slot are quiet too.
- FDMA: cos(2 pi k t / N) with k whole periods in a cycle, held during a chip, or the sine, which makes a rotating field
  with the cosine of a crossed coil; or the sign of the cosine, which a bridge of two levels can drive. Harmonics of
  square waves overlap, yet all 511 of N = 1023 and a constant are independent of each other.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from goldfield.access.gold import code_matrix
from goldfield.access.rise import filtered
from goldfield.site import Beacon, Site
from goldfield.site.drive import Code
from goldfield.types import FloatArray


def code_template(chips: int, codes: Sequence[Code]) -> FloatArray:
    """Return the sum of codes with equal parts and a peak of 1, shape (N,)."""
    total = np.zeros(chips)
    for code in codes:
        own = code_matrix(code.degree, [code.index])[:, 0].astype(np.float64)
        total += np.resize(np.repeat(np.roll(own, -code.offset), code.hold), chips)
    return np.asarray(total / len(codes))


def slot_template(chips: int, slots: int, slot: int) -> FloatArray:
    """Return the pulse of direct current in one of equal slots, shape (N,)."""
    length = chips // slots
    total = np.zeros(chips)
    total[slot * length : (slot + 1) * length] = 1.0
    return total


def tone_template(chips: int, periods: int, square: bool = False, wave: str = "cosine") -> FloatArray:
    """Return an alternating current with whole periods in a cycle, a cosine, its sign, or a sine, shape (N,)."""
    turn = 2.0 * np.pi * periods * np.arange(chips) / chips
    if wave == "sine":
        return np.asarray(np.sin(turn))
    return np.asarray(np.sign(np.cos(turn)) if square else np.cos(turn))


def free_tone_template(chips: int, turns_a_sample: float) -> FloatArray:
    """Return a cosine of any frequency, shape (N,): a tone whose phase is unknown, as if it were 0."""
    return np.asarray(np.cos(2.0 * np.pi * turns_a_sample * np.arange(chips)))


def beacon_template(site: Site, beacon: Beacon, rise: bool = True) -> FloatArray:
    """Return the template of one beacon of a site, shape (N,), with its coil's rise or without."""
    drive = beacon.drive
    if drive.slot is not None:
        ideal = slot_template(site.chips, site.slots, drive.slot)
    elif drive.frequency_Hz is not None:
        ideal = free_tone_template(site.chips, drive.frequency_Hz * site.chip_period_s)
    elif drive.periods is not None:
        ideal = tone_template(site.chips, drive.periods, drive.square, drive.wave)
    else:
        ideal = code_template(site.chips, drive.codes or (Code(beacon.code, site.degree),))
    return filtered(ideal, drive.tau_s / site.chip_period_s) if rise else ideal


def site_templates(site: Site, rise: bool = True) -> FloatArray:
    """Return the templates of all beacons of a site as columns, shape (N, n)."""
    return np.stack([beacon_template(site, beacon, rise) for beacon in site.beacons], axis=1)
