"""The two banks of a track: what they say together."""

import numpy as np

from goldfield.field import FieldModel
from goldfield.track.blocks.bank import Bank, Start
from goldfield.track.blocks.pair import Pair
from tests.bench.locate_trials import prigge_cube
from tests.bench.motion_trials import EARTH_T
from tests.host.track.blocks.flights import MIDDLE_M

NOISE_T = 2e-7


def test_what_two_banks_say_ahead_needs_no_inverse():
    """The covariance of a bank in single precision may be none for a moment, which ended the program."""
    model = FieldModel(prigge_cube(NOISE_T).beacons)
    pair = Pair(lambda: Bank(model), model)
    start = Start(MIDDLE_M, np.eye(3), np.diag([1e-4] * 3 + [1e-3] * 3), EARTH_T, 1e-12 * np.eye(3))
    pair.start(start)
    pair._weight = 0.5
    pair._alone._covariance[:, 0, 0] = -1e-6
    ahead = pair.output(1e-3)
    assert np.isfinite(ahead.covariance).all()
