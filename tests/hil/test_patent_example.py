"""The patent's example on the whole chain: three beacons whose fields are 12, 6 and 1 mG."""

import numpy as np
import pytest

from goldfield.access.epoch import EpochSeparator

pytestmark = pytest.mark.slow  # on emulated boards: `make test-host-boards` runs it too


@pytest.fixture(scope="module")
def bench(open_bench):
    return open_bench("patent3")


def test_amplitudes_after_correction(bench):
    separator = EpochSeparator(bench.site)
    fields = [separator.fields(report) for report in bench.reports(10)]
    mean = np.mean([f.field_T for f in fields], axis=0)
    assert fields[0].beacons == ("strong", "middle", "weak")
    assert np.linalg.norm(mean, axis=1) / 1e-7 == pytest.approx([12.0, 6.0, 1.0], rel=0.01)
