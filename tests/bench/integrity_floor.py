"""The fewest poses with a wrong sensor that any test can miss, to be read beside those that the locator missed.

The test that is bounded here knows more than any real one: which axis has the wrong gain, how wrong it is, and what
the field is; only the pose is its unknown. The most powerful such test looks along the one direction in which the
fault shows beside the pose (Neyman and Pearson), a normal number of standard deviation 1 whose mean is the fault's
size. All of its false alarms are spent on it.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.stats import norm

from goldfield.site import Site
from tests.bench.integrity_coils import Coils
from tests.bench.integrity_survey import slopes, turns
from tests.bench.locate_trials import Trials

FloatArray = NDArray[np.float64]

FALSE_ALARMS = 1e-3
"""Share of sound poses that may be other than `ok`."""


def fault_size(site: Site, trials: Trials, sensor: FloatArray) -> FloatArray:
    """Return how far a sensor's fault stands out of the noise beside any pose, standard deviations, shape (e,).

    Parameters
    ----------
    site : Site
        Exact, as is everything but the sensor.
    trials : Trials
    sensor : ndarray, shape (3, 3)
        What the sensor makes of a field in its own frame; 1 if it is sound.
    """
    coils = Coils.of(site, len(trials.position_m))
    field = coils.field(trials.position_m)
    pose = np.concatenate([slopes(coils, trials.position_m), turns(field)], axis=3)
    seen = np.einsum("eki,enk->eni", trials.rotation, field)
    fault = np.einsum("eij,jk,enk->eni", trials.rotation, sensor - np.eye(3), seen)
    size = trials.sigma_T[:, :, None]
    basis, _ = np.linalg.qr((pose / size[..., None]).reshape(len(field), -1, 6))
    column = (fault / size).reshape(len(field), -1)
    rest = column - np.einsum("emk,elk,el->em", basis, basis, column)
    return np.linalg.norm(rest, axis=1)


def fewest_missed(site: Site, trials: Trials, sensor: FloatArray) -> float:
    """Return how many of the poses the best test misses on average, with `FALSE_ALARMS`."""
    return float(norm.cdf(norm.isf(FALSE_ALARMS) - fault_size(site, trials, sensor)).sum())
