"""What locating one epoch may cost: one budget that the search of its pose and all explanations of its fields share."""

from __future__ import annotations

MOST_FIELDS = 200_000
"""Fields and gradients of single coils at single points that an epoch may take, about 0.1 us each: eight coils are
evaluated 25,000 times, twelve 16,700 times. Of 1,500 epochs with up to four faults and up to twelve coils one took more
than 151,000."""

LEAST_EVALUATIONS = 10_000
"""More than twenty coils are evaluated so often all the same, which is as much as one search may take."""


class Budget:
    """Evaluations of the field that are left for one epoch.

    Whatever fits a pose says what it took (`spend`) and takes no more than is left (`evaluations`). What is found after
    the budget was spent proves nothing: the pose is then `weak`, or `inconsistent` if nothing fits the fields so far.

    Parameters
    ----------
    coils : int
        How many coils were heard.
    """

    def __init__(self, coils: int) -> None:
        self._left = max(MOST_FIELDS, LEAST_EVALUATIONS * coils)

    @property
    def spent(self) -> bool:
        """True if nothing is left."""
        return self._left <= 0

    def evaluations(self, coils: int) -> int:
        """Return how many evaluations of so many coils are left."""
        return max(self._left // coils, 0)

    def spend(self, evaluations: int, coils: int) -> None:
        """Take evaluations of so many coils off what is left."""
        self._left -= evaluations * coils
