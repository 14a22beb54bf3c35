"""The maps that are drawn: which figures, in which units, on which scale."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from goldfield.planning.maps import Figures
from goldfield.types import FloatArray

DECADES = 3.0
"""Most decades that a scale shows: what is beyond has the colour of its end."""


def shown(value: float) -> str:
    """Return a figure for people: three digits, all of a larger whole number, no exponent.

    Examples
    --------
    >>> shown(0.01234), shown(98.76), shown(4321.0), shown(np.inf)
    ('0.0123', '98.8', '4321', 'unbounded')
    """
    if not np.isfinite(value):
        return "unbounded"
    return f"{value:.0f}" if abs(value) >= 1000.0 else f"{value:.3g}"


@dataclass(frozen=True)
class Layer:
    """A figure that is drawn as a map.

    Attributes
    ----------
    key : str
        Name of the array of `Figures`.
    title, unit : str
    factor : float
        Multiplied with the array's values it gives those of the unit.
    """

    key: str
    title: str
    unit: str
    factor: float

    def values(self, figures: Figures) -> FloatArray:
        """Return the map in its unit, shape (nx, ny, nz); infinite where there is no bound."""
        return np.asarray(self.factor * getattr(figures, self.key))

    def scale(self, figures: Figures) -> tuple[float, float]:
        """Return the ends of the logarithmic scale: the least value, and nearly the largest but `DECADES` above it."""
        values = self.values(figures)
        values = values[np.isfinite(values) & (values > 0.0)]
        if not len(values):
            return 1.0, 10.0
        least, largest = float(values.min()), float(np.quantile(values, 0.999))
        return least, min(max(largest, 1.2 * least), 10.0**DECADES * least)


LAYERS = (
    Layer("position_sd_m", "position bound", "cm", 100.0),
    Layer("attitude_sd_rad", "attitude bound", "deg", 180.0 / np.pi),
    Layer("protection_m", "protection level", "cm", 100.0),
)
"""What a picture shows; `MORE_LAYERS` are the others of a page."""

MORE_LAYERS = (
    Layer("best_position_sd_m", "position bound, best-K set alone", "cm", 100.0),
    Layer("dilution_m_T", "dilution", "cm per nT", 1e-7),
)
