"""Fields that are nothing but noise, which no pose is computed of."""

from __future__ import annotations

from functools import cache

import numpy as np
from numpy.typing import NDArray

from goldfield.locate.chances import chdtri
from goldfield.locate.fit import Measurements
from goldfield.types import FloatArray

SILENCE = 1e-4
"""Fields are nothing but noise unless those without the strongest beacon are less likely than this to be noise.

One beacon alone gives no pose. Noise alone passes in fewer than one epoch of 10,000 then, noise beside one beacon in
one of 10,000. What is lost are far poses: the energy over the noise that passes in half of the epochs is 30 for eight
beacons, 2.1 standard deviations each; of poses at the limit of `weak` by distance, .5 to 2 % fail."""


def audible(measurements: Measurements) -> NDArray[np.bool_]:
    """Tell which epochs, shape (e,), are more than noise and at most one beacon; see `SILENCE`."""
    energy = (measurements.magnitude_T / measurements.sigma_T) ** 2
    strongest = energy.argmax(axis=1)
    everyone = np.arange(len(energy))
    count = measurements.count - measurements.measured.sum(axis=2)[everyone, strongest]
    energy[everyone, strongest] = 0.0
    return np.asarray(energy.sum(axis=1) > _of_silence(3 * energy.shape[1] - 3)[count])


@cache
def _of_silence(components: int) -> FloatArray:
    """Return the energies that so many components of noise, and of fewer, exceed in `SILENCE` of the epochs."""
    return chdtri(np.maximum(np.arange(components + 1.0), 1.0), SILENCE)
