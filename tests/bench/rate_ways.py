"""Ways to follow a sensor from its samples and how far off each is: block filter, held fixes, whole cycles."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from goldfield.access import Separator
from goldfield.access.sweep import SweepRepair
from goldfield.locate import Locator
from goldfield.track import Tracker
from goldfield.track.blocks import BlockSmoother
from goldfield.types import Fields, Status
from tests.bench.motion_trials import CHIPS
from tests.bench.rate_world import BLOCK_CHIPS

FIVE_SIGMA = 31.8
"""Squared Mahalanobis distance of three numbers that is as rare as five standard deviations of one, 5.7e-7."""


@dataclass(frozen=True, eq=False)
class Errors:
    """How far off poses were at the moments that they are told for; one row a pose, NaN where there was none.

    Attributes
    ----------
    time_s : ndarray, shape (n,)
    position_m, attitude_rad : ndarray, shape (n, 3)
    position_d2, attitude_d2 : ndarray, shape (n,)
        Squares of the errors normalised by the pose's own covariance: 3 on the average.
    protection_m : ndarray, shape (n,)
    status : ndarray of str, shape (n,)
    """

    time_s: object
    position_m: object
    attitude_rad: object
    position_d2: object
    attitude_d2: object
    protection_m: object
    status: object

    @classmethod
    def joined(cls, several):
        """Return the rows of several runs."""
        names = cls.__dataclass_fields__
        return cls(*(np.concatenate([getattr(errors, name) for errors in several]) for name in names))

    def after(self, time_s):
        """Return the rows from a time on."""
        return self.where(self.time_s > time_s)

    def where(self, chosen):
        """Return some rows."""
        return Errors(*(getattr(self, name)[chosen] for name in self.__dataclass_fields__))

    @property
    def distance_m(self):
        """Distances from the truth, shape (n,)."""
        return np.linalg.norm(self.position_m, axis=1)

    @property
    def rms_mm(self):
        """Root mean square of the position's error, mm."""
        return 1e3 * float(np.sqrt(np.nanmean(self.distance_m**2)))

    @property
    def rms_deg(self):
        """Root mean square of the angle, degrees."""
        return float(np.degrees(np.sqrt(np.nanmean((self.attitude_rad**2).sum(axis=1)))))

    @property
    def nees(self):
        """Mean of the normalised squares of all six numbers: 1 if the told covariance is right."""
        return float(np.nanmean(self.position_d2 + self.attitude_d2) / 6.0)

    @property
    def share_ok(self):
        """Share of the poses with status ``ok``."""
        return float(np.mean(self.status == Status.OK))

    @property
    def far(self):
        """Which poses are off by five of their own deviations, shape (n,)."""
        return (self.position_d2 > FIVE_SIGMA) | (self.attitude_d2 > FIVE_SIGMA)

    @property
    def unprotected(self):
        """Which poses are off by more than their protection level, shape (n,)."""
        return self.distance_m > self.protection_m

    @property
    def unsaid(self):
        """Which poses are ``ok`` and yet far or unprotected, shape (n,)."""
        return (self.status == Status.OK) & (self.far | self.unprotected)

    @property
    def wrong(self):
        """How many poses are ``ok`` and far, and how many ``ok`` and unprotected, as a text."""
        claimed = self.status == Status.OK
        return f"{np.sum(claimed & self.far)}+{np.sum(claimed & self.unprotected)}"


def errors_of(poses, position_m, rotation):
    """Return the errors of poses, None among them, against the truth at their times: (n, 3) and n rotations."""
    rows = [_error(pose, place, turn) for pose, place, turn in zip(poses, position_m, rotation, strict=True)]
    columns = list(zip(*rows, strict=True))
    return Errors(*(np.array(column) for column in columns))


def _error(pose, place, turn):
    nothing = np.full(3, np.nan)
    if pose is None or not np.all(np.isfinite(pose.position_m)):
        time_s = np.nan if pose is None else pose.time_s
        return time_s, nothing, nothing, np.nan, np.nan, np.nan, Status.FAILED
    position = pose.position_m - place
    attitude = (Rotation.from_quat(pose.orientation_xyzw) * turn.inv()).as_rotvec()
    return (
        pose.time_s,
        position,
        attitude,
        position @ np.linalg.solve(pose.position_cov_m2, position),
        attitude @ np.linalg.solve(pose.attitude_cov_rad2, attitude),
        pose.protection_m,
        pose.status,
    )


def follow(track, block_filter, first=0, lost=lambda number: False):
    """Return the errors of a block filter, one row a block; ``lost`` tells by its number which block never comes."""
    ends, poses = [], []
    for number, (last, block) in enumerate(track.blocks(first)):
        if not lost(number):
            ends.append(last)
            poses.append(block_filter.update(block))
    return errors_of(poses, track.position_m[ends], track.rotation[ends])


def lagged(track):
    """Return the errors of the block filter's poses 50 ms later, one a cycle: at the end of the block in its middle."""
    last = np.array([end for end, _ in track.blocks()])
    poses = list(BlockSmoother(track.site).poses(block for _, block in track.blocks()))
    errors = errors_of(poses, track.position_m[last], track.rotation[last])
    return errors.where(last % CHIPS // BLOCK_CHIPS == CHIPS // BLOCK_CHIPS // 2)


def _cycles(track):
    return range(len(track.times_s) // CHIPS)


def _held(track, pose_at):
    """Return the errors at the ends of blocks of what is known from the cycles before; ``pose_at(cycle, time_s)``."""
    ends, poses = [], []
    for last, block in track.blocks():
        cycle = (last + 1) // CHIPS - 1  # the latest that is over
        if cycle >= 0:
            ends.append(last)
            poses.append(pose_at(cycle, block.time_s))
    return errors_of(poses, track.position_m[ends], track.rotation[ends])


def _fields(track, cycle):
    """Return the separated fields of a cycle.

    Its middle lies half a chip after the end of its chip 510: the fields are told that time.
    """
    site = track.site
    separator = Separator(site.degree, site.codes, site.sensor.noise_T)
    separation = separator.from_samples(track.samples_T[cycle * CHIPS : (cycle + 1) * CHIPS])
    middle_s = float(track.times_s[cycle * CHIPS + CHIPS // 2 - 1]) + 0.5 * site.chip_period_s
    names = tuple(beacon.id for beacon in site.beacons)
    return Fields(cycle, middle_s, names, separation.field_T, separation.sigma_T)


def held_fixes(track):
    """Return the errors of one fix a cycle, held until the next."""
    locator = Locator(track.site)
    fixes = [locator.locate(_fields(track, cycle)) for cycle in _cycles(track)]
    return _held(track, lambda cycle, _: fixes[cycle])


def cycles(track):
    """Return the errors of a track of whole cycles: at the middles of its cycles, and at the ends of blocks after them.

    It has what a sensor sends where no blocks come: the fields and the mean of each cycle.
    """
    tracker, sweep = Tracker(track.site), SweepRepair(track.site)
    own, ahead = [], {}
    middles = [cycle * CHIPS + CHIPS // 2 - 1 for cycle in _cycles(track)]
    for cycle in _cycles(track):
        mean_T = track.samples_T[cycle * CHIPS : (cycle + 1) * CHIPS].mean(axis=0)
        own.append(tracker.update(sweep.repaired(_fields(track, cycle), mean_T)))
        first = (cycle + 1) * CHIPS - 1
        for last, block in track.blocks():
            if first <= last < first + CHIPS:
                ahead[last] = tracker.pose_at(block.time_s)
    ends = sorted(ahead)
    later = errors_of([ahead[last] for last in ends], track.position_m[ends], track.rotation[ends])
    halfway = 0.5 * (track.position_m[middles] + track.position_m[np.array(middles) + 1])
    return errors_of(own, halfway, track.rotation[middles]), later
