"""What the sweep of the ambient field tells, by its rows alone: the dense calculation's in double precision."""

from dataclasses import replace

import numpy as np
import pytest

from tests.firmware.core.track import dense
from tests.firmware.core.track.test_block_measure import Case


class Swept(Case):
    """A block, measured, and its sweep."""

    def single(self):
        """Rows of the sweep, and how many tell something."""
        super().single()
        sweep = self.kernel.ffi.new("block_sweep_t *")
        sweep.rows = [[7.0] * 19] * 3
        rank = self.kernel.lib.block_sweep(self.kernel.block, self.measure, sweep)
        return self.kernel.matrix(sweep.rows), rank

    def dense(self, place=None):
        """The same in double precision, but for a turn of the rows."""
        y, rows = dense.measured(self.coils, self.reference, self.gram, self.moment, self.data, self.noise)
        return np.column_stack([rows, y])[9:]


def told(rows):
    """What rows tell, whichever way they are turned."""
    return rows.T @ rows


@pytest.mark.parametrize(("beacons", "most"), [(3, 0.1), (8, 3e-3), (16, 5e-3)])
@pytest.mark.parametrize("noise", [0.02, 1.0])
def test_the_sweep_tells_what_its_whitened_rows_tell(core, gold_family, beacons, most, noise):
    case = Swept(core, gold_family, beacons, noise=noise)
    ours, rank = case.single()
    truth = told(case.dense())[3:, 3:]
    size = np.sqrt(np.diag(truth)) + 1e-9
    assert rank == 3
    assert not ours[:, :3].any()
    assert np.abs((told(ours)[3:, 3:] - truth) / np.outer(size, size)).max() < most


def test_one_beacon_leaves_nothing_of_the_sweep(core, gold_family):
    rows, rank = Swept(core, gold_family, 1).single()
    assert rank == 0
    assert not rows.any()


def test_among_silent_beacons_the_whole_ramp_tells(core, gold_family):
    """Nothing is told of position and turn then, and the ambient field's rows have nothing in common with the ramp."""
    case = Swept(core, gold_family)
    case.coils = replace(case.coils, k=np.zeros(8))
    for coil in case.kernel.coils:
        coil.k_uT_m3 = 0.0
    case.kernel.fill(case.words, dense.sums(case.coils, case.truth, case.gram, case.moment))
    rows, rank = case.single()
    assert case.measure.rank == 3
    assert rank == 3
    square = case.moment[-1] @ np.linalg.solve(case.gram, case.moment[-1]) / case.noise**2
    even = 1.0 / (1.0 + dense.UNEVEN**2 * square)

    def sweep(state):
        """How fast the ambient field changes in the sensor's frame, turned by the reference's attitude."""
        return case.reference.rotation @ state.rotation.T @ np.cross(state.e, state.w)

    left = sweep(case.truth) - sweep(case.reference)
    slopes = dense.slope(sweep, case.reference, range(18))
    truth = even * square * told(np.column_stack([slopes, left]))
    size = np.sqrt(np.diag(truth)) + 1e-9
    assert np.abs((told(rows) - truth) / np.outer(size, size)).max() < 1e-4


def test_the_sweep_of_a_block_that_a_beacon_is_left_out_of(core, gold_family):
    case = Swept(core, gold_family)
    case.leave_out(3)
    (ours, rank), truth = case.single(), told(case.dense())[3:, 3:]
    size = np.sqrt(np.diag(truth)) + 1e-9
    assert rank == 3
    assert np.abs((told(ours)[3:, 3:] - truth) / np.outer(size, size)).max() < 3e-3
