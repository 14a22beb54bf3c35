"""How often a sensor that computes its own poses from blocks of chips sends one."""

from __future__ import annotations

from goldfield.errors import UserError, option
from goldfield.link.blocks import BLOCK_CHIPS
from goldfield.site import Site
from goldfield_protocol.parameters import PARAMETERS

MOST_POSE_BLOCKS = int(PARAMETERS["pose_blocks"].high)
"""Most blocks that a sensor takes between two of its poses."""


def blocks_a_pose(site: Site, rate_hz: float) -> int:
    """Return after how many of its blocks a sensor is to send a pose.

    Raises
    ------
    UserError
        If that is less often than a sensor does.
    """
    blocks = round(max(1.0, 1.0 / max(rate_hz * BLOCK_CHIPS * site.chip_period_s, 1e-9)))
    if blocks > MOST_POSE_BLOCKS:
        least_Hz = 1.0 / (MOST_POSE_BLOCKS * BLOCK_CHIPS * site.chip_period_s)
        raise UserError(
            f"{option('rate_hz')}: {rate_hz:g} Hz is less often than a sensor sends poses of blocks, "
            f"{least_Hz:.3g} Hz: give a higher rate, or none for a pose of each cycle"
        )
    return blocks
