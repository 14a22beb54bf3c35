"""A pose from every block of chips: the filter of docs/blocks.md in NumPy, for every kind of site."""

from goldfield.track.blocks.filter import BlockFilter, Tracked
from goldfield.track.blocks.smoother import BlockSmoother

__all__ = ["BlockFilter", "BlockSmoother", "Tracked"]
