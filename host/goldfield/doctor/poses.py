"""The beacons and the sensor, by the fields of some epochs: what explains them better than the site file does."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

from goldfield.doctor.checks import Check, Fault, sound, unjudged, wrong
from goldfield.errors import counted
from goldfield.sensor.pipeline import Epoch
from goldfield.sensor.strength import Strength, Strengths, mean_strengths
from goldfield.site import Site
from goldfield.types import Explanation, Finding, Status

FAULTS = {
    Explanation.MIRRORED: Fault.AXES,
    Explanation.AXIS_GAIN: Fault.AXES,
    Explanation.SENSOR: Fault.AXES,
    Explanation.STRENGTH: Fault.CURRENT,
    Explanation.UNITS: Fault.SITE,
    Explanation.DEAD: Fault.OFF,
    Explanation.REVERSED: Fault.REVERSED,
    Explanation.CURRENT: Fault.CURRENT,
    Explanation.MOVED: Fault.BEACON,
    Explanation.BEACON: Fault.BEACON,
    Explanation.CLOCK: Fault.CLOCK,
    Explanation.UNKNOWN: Fault.SITE,
}
"""The fault that each finding of the location means; a board's own words are judged elsewhere."""

SHARE = 0.5
"""A finding counts that at least this share of the epochs has."""
REVERSED = -0.5
"""A beacon's field along the expected one, over the expected one, below which its coil is reversed."""


@dataclass(frozen=True)
class Seen:
    """What some epochs showed.

    Attributes
    ----------
    epochs : sequence of Epoch
    strengths : dict of str to Strength
        Each beacon's strength by its id.
    """

    epochs: Sequence[Epoch]
    strengths: dict[str, Strength]


def seen(site: Site, epochs: Sequence[Epoch]) -> Seen:
    """Return what some epochs of a sensor showed."""
    strengths = Strengths(site)
    return Seen(epochs, mean_strengths([strengths.of(epoch) for epoch in epochs]))


def judged(view: Seen, site: Site, known: Sequence[Check]) -> Iterator[Check]:
    """Yield what the fields say is wrong, without what the boards have said of the same beacons already.

    Parameters
    ----------
    view : Seen
    site : Site
    known : sequence of Check
        Faults that were found before.
    """
    yield from _samples(view)
    named = {beacon for check in known if check.fault is not None for beacon in check.beacons}
    faults = list(_faults(view, site, named))
    yield from faults
    statuses = Counter(epoch.pose.status for epoch in view.epochs)
    bad = statuses[Status.INCONSISTENT] + statuses[Status.FAILED]
    explained = bool(faults) or any(check.fault is not None for check in known)
    if bad >= SHARE * len(view.epochs) and not explained:
        reasons = Counter(epoch.pose.reason or "" for epoch in view.epochs)
        text = reasons.most_common(1)[0][0].rpartition(": ")
        yield wrong(
            Fault.SITE,
            "site file",
            f"{bad} of {len(view.epochs)} epochs fit no pose: {text[0] or text[2]}",
            f'check that the site file, "{site.name}", is that of this room: positions, axes and codes of its beacons',
        )
    elif bad >= SHARE * len(view.epochs):
        yield unjudged("poses", "no pose fits: mend what is named here, then look again")
    else:
        said = ", ".join(f"{count} {status.value}" for status, count in statuses.most_common())
        yield sound("poses", f"{counted(len(view.epochs), 'epochs')}: {said}")
    yield from _sound_beacons(view, named | {beacon for check in faults for beacon in check.beacons})


def _samples(view: Seen) -> Iterator[Check]:
    count = len(view.epochs)
    saturated = sum(bool(epoch.report.saturated) for epoch in view.epochs)
    lost = sum(epoch.lost for epoch in view.epochs)
    if saturated >= SHARE * count:
        yield wrong(
            Fault.SENSOR,
            "sensor",
            f"converters saturate in {saturated} of {count} cycles",
            "move the sensor away from iron, magnets and the nearest coil, or lower that coil's current",
        )
    if lost > 0.01 * count * (3 + len(view.strengths)):
        yield wrong(
            Fault.LINK,
            "link",
            f"of {counted(count, 'cycles')} {counted(lost, 'messages were lost')}",
            "check the adapter, its cable and what else uses the link",
        )


def _faults(view: Seen, site: Site, named: set[str]) -> Iterator[Check]:
    """Yield the findings that most epochs have, the most frequent first."""
    counts: Counter[tuple[Explanation, tuple[str, ...]]] = Counter()
    latest: dict[tuple[Explanation, tuple[str, ...]], Finding] = {}
    for epoch in view.epochs:
        for key, finding in {(f.kind, f.beacons): f for f in epoch.pose.findings}.items():
            counts[key] += 1
            latest[key] = finding
    for key, count in counts.most_common():
        kind, beacons = key
        if count < SHARE * len(view.epochs) or kind not in FAULTS or named & set(beacons):
            continue
        fault = FAULTS[kind]
        if kind is Explanation.BEACON and all(view.strengths[name].ratio < REVERSED for name in beacons):
            fault = Fault.REVERSED
        text, _, advice = latest[key].text.rpartition(": ")
        if fault is Fault.OFF:
            codes = " and ".join(str(site.beacon(name).code) for name in beacons)
            advice = f"check its power, its coil, and that its board drives the code {codes} (goldfield nodes on CAN)"
        yield wrong(
            fault,
            f"beacon {' and '.join(beacons)}" if beacons else "sensor",
            text or latest[key].text,
            advice or "check the site file",
            beacons=beacons,
        )


def _sound_beacons(view: Seen, faulty: set[str]) -> Iterator[Check]:
    """Yield the strength of each beacon of which nothing is wrong, and of those that are too weak to be judged."""
    for name, strength in view.strengths.items():
        if name in faulty:
            continue
        said = f"{strength.measured_T * 1e9:.0f} nT of {strength.expected_T * 1e9:.0f} nT expected"
        if strength.used:
            yield sound(f"beacon {name}", f"{said}, ratio {strength.ratio:.3f}")
        else:
            yield unjudged(f"beacon {name}", f"the poses do without it ({said})")
