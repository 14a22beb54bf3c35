"""What the errors of the site and the sensor do to an observation, and through the filter to what is believed.

They stay the same from cycle to cycle. A filter that took them for noise would average them away and report a
covariance far too small; one that ignored them would trust a near beacon to micrometres and call the next one faulty.
So the filter's gain takes them for noise that is new in each cycle (`Observation.around`), and beside it goes along
what they do in truth: the sensitivity D of the state to them, of which an update with the gain K, the Jacobian H and
the effect J makes (1 - K H) D - K J. The state's covariance is then D D' and what noise and motion make of it. These
are the consider states of Schmidt, with a gain that is not his optimal one.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from goldfield.field import FieldModel
from goldfield.locate import kernel
from goldfield.locate.site_errors import SiteErrors, effects_of_beacons
from goldfield.types import FloatArray

OF_BEACON = 7
OF_SENSOR = 9
"""Errors of each beacon (place, turn, current), and of the sensor (the elements of a matrix)."""


@dataclass(frozen=True, eq=False)
class Deviations:
    """The errors of the beacons of an observation among all that there are.

    Attributes
    ----------
    errors : SiteErrors
        Standard deviations of the observation's n beacons and of the sensor.
    rows : ndarray of int, shape (n,)
        Places of the beacons among those of the site.
    beacons : int
        Number of the site's beacons.
    """

    errors: SiteErrors
    rows: NDArray[np.intp]
    beacons: int

    def effect(
        self,
        model: FieldModel,
        seen: FloatArray,
        position_m: FloatArray,
        rotation: FloatArray,
        ambient_T: FloatArray,
    ) -> FloatArray:
        """Return what each error, in standard deviations, adds to an observation's numbers.

        Parameters
        ----------
        model : FieldModel
            The n beacons.
        seen : ndarray, shape (3, r, (n + 1) k)
            `Observation.seen`.
        position_m, rotation : ndarray, shapes (k, 3) and (k, 3, 3)
            Poses at the nodes of the cycle.
        ambient_T : ndarray, shape (3,)
            Ambient field in the site's frame: the sensor's errors distort it too while it turns.

        Returns
        -------
        effect : ndarray, shape (3 r, 7 beacons + 9)
            First the errors of the site's beacons, then those of the sensor.
        """
        count, numbers = len(model), seen.shape[1]
        by_node = seen.reshape(3, numbers, count + 1, -1)
        evaluated = kernel.evaluate(model, position_m.T)
        of_beacons, field = effects_of_beacons(model, self.errors, position_m, evaluated)
        in_sensor = (rotation.swapaxes(1, 2)[:, None] @ of_beacons).transpose(2, 1, 0, 3)  # (3, n, k, 7)
        fields = np.concatenate([field, np.broadcast_to(ambient_T, (len(field), 1, 3))], axis=1) @ rotation
        fields = fields.swapaxes(0, 1).reshape(-1, 3)
        effect = np.zeros((3, numbers, OF_BEACON * self.beacons + OF_SENSOR))
        for axis in range(3):
            deviation = np.where(np.arange(3) == axis, self.errors.gain_sd, self.errors.sensor_axis_sd_rad)
            first = OF_BEACON * self.beacons + 3 * axis
            effect[axis, :, first : first + 3] = seen[axis] @ fields * deviation
            each = by_node[axis, :, :count].swapaxes(0, 1) @ in_sensor[axis]  # (n, r, 7)
            for beacon, row in enumerate(self.rows):
                effect[axis, :, OF_BEACON * row : OF_BEACON * (row + 1)] = each[beacon]
        return effect.reshape(3 * numbers, -1)
