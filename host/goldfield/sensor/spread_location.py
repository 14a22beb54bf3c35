"""The poses of a long table of fields, located by many processes or machines: the same as one after the other.

What an epoch is by itself does not depend on others, and takes the time: it is spread. What follows from the history,
which is quick, is done here in order: a beacon that the history names, and the signs of quaternions. The few epochs in
which it names one are located again.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from contextlib import closing
from functools import partial

from goldfield.locate import locate
from goldfield.planning.spreading import spread
from goldfield.sensor.guard import guarded
from goldfield.sensor.location import Each, Succession
from goldfield.site import Site
from goldfield.types import Fields, Pose

BATCH = 100
"""Epochs that are sent at once: tenths of a second of work."""


def spread_poses(
    site: Site, epochs: Iterable[Fields], *, workers: int = 1, scheduler: str | None = None
) -> Iterator[Pose]:
    """Yield the poses that `goldfield.sensor.location.location` makes of the epochs, each by itself.

    Parameters
    ----------
    site : Site
    epochs : iterable of Fields
        They are all read before the first pose.
    workers, scheduler
        As for `goldfield.planning.plan`.

    Raises
    ------
    UserError
        If the site cannot be located on.
    SystemFailure
        If the scheduler does not answer or has no workers, or a worker dies.
    """
    all_fields = list(epochs)
    items = list(enumerate(all_fields))
    batches = [items[first : first + BATCH] for first in range(0, len(items), BATCH)]
    ready: dict[int, Pose | None] = {}
    each, succession, place = Each(site), Succession(), 0
    with closing(spread(located_batch, site, batches, workers=workers, scheduler=scheduler)) as results:
        for number, pose in results:
            ready[number] = pose
            while place in ready:
                located = partial(each.pose, ready=ready.pop(place))
                yield succession.follow(guarded(located, all_fields[place]))
                place += 1


def located_batch(site: Site, items: list[tuple[int, Fields]]) -> list[tuple[int, Pose | None]]:
    """Return the pose of each epoch by itself, by its number; None where it fails unexpectedly: who asked will see."""
    return [(number, _located(site, fields)) for number, fields in items]


def _located(site: Site, fields: Fields) -> Pose | None:
    try:
        return locate(site, fields)
    except Exception:
        return None
