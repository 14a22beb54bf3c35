"""The track of one sensor from blocks of chips: a pose with each, at the end of the block (docs/blocks.md)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from goldfield.site import Site
from goldfield.types import Block, FloatArray, Pose


@dataclass(frozen=True, eq=False)
class Tracked:
    """What a `BlockFilter` knows of the sensor at one moment.

    Attributes
    ----------
    time_s : float
    position_m : ndarray, shape (3,)
    rotation : ndarray, shape (3, 3)
        ``B_site = R B_sensor``.
    velocity_m_s, rate_rad_s : ndarray, shape (3,)
        In the site's frame.
    ambient_T : ndarray, shape (3,)
        In the site's frame.
    offset_T : ndarray, shape (3,)
        The sensor's offset, in its own frame.
    covariance : ndarray, shape (18, 18)
        Of the errors of all these, in this order; that of the attitude is a small rotation in the site's frame.
    """

    time_s: float
    position_m: FloatArray
    rotation: FloatArray
    velocity_m_s: FloatArray
    rate_rad_s: FloatArray
    ambient_T: FloatArray
    offset_T: FloatArray
    covariance: FloatArray


class BlockFilter:
    """Tracks one sensor: give it every block in the order of time, it returns the pose at each block's end.

    Parameters
    ----------
    site : Site
    kernel : bool
        Take the C version where it serves: circular coils, no metal, axes of equal noise.

    Raises
    ------
    UserError
        If the site is of a kind that no block filter can follow: tones of unknown phase, or a sensor with levers.
    """

    def __init__(self, site: Site, *, kernel: bool = True) -> None:
        raise NotImplementedError

    def update(self, block: Block, without: Sequence[str] = ()) -> Pose | None:
        """Take a block and return the pose at its end, the time of its last sample; None if it holds no data.

        The pose's ``epoch`` is the cycle of the block's last chip. ``without`` lists beacons that are left out.
        """
        raise NotImplementedError

    def pose_at(self, time_s: float) -> Pose:
        """Return the pose at any time near the last block's, with the uncertainty that the motion adds."""
        raise NotImplementedError

    @property
    def state(self) -> Tracked | None:
        """What is known at the end of the last block; None without a track."""
        raise NotImplementedError
