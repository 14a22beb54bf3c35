"""What a pose costs among coils nearly in a plane, of whose images none is ruled out by a half-space.

    python -m tests.bench.flat_figures            20, 60 and 120 coils, 3 m apart
    python -m tests.bench.flat_figures 40         so many

Each coil stands 20 mm off the plane at random and leans by 0.6 degrees, the sensor is 2.5 to 3.5 m below. Processor
time, ms a pose, one thread if ``OPENBLAS_NUM_THREADS`` is 1.
"""

from __future__ import annotations

import sys
import time

import numpy as np

from goldfield.locate import Locator
from tests.bench import locate_trials as trials

SIZES = (20, 60, 120)
SPACING_M, OFF_M, LEAN, NOISE_T, POSES = 3.0, 0.02, 0.01, 2e-8, 12


def milliseconds(coils: int) -> float:
    """Return the processor time of a pose among so many coils, ms."""
    rng = np.random.default_rng(1)
    columns = int(np.ceil(np.sqrt(coils)))
    places = [(SPACING_M * (i // columns), SPACING_M * (i % columns), rng.normal(0.0, OFF_M)) for i in range(coils)]
    leaning = [(rng.normal(0.0, LEAN), rng.normal(0.0, LEAN), -1.0) for _ in places]
    beacons = [trials.loop_beacon(i, *each) for i, each in enumerate(zip(places, leaning, strict=True))]
    site = trials.site_of(beacons, None, NOISE_T)
    far_m = SPACING_M * (columns - 2)
    at_m = rng.uniform([SPACING_M, SPACING_M, -3.5], [far_m, far_m, -2.5], size=(POSES, 3))
    epochs = trials.fields_of(site, trials.trials(site, at_m, rng))
    locator = Locator(site)
    locator.locate(epochs[0])
    begin_s = time.process_time()
    for epoch in epochs:
        locator.locate(epoch)
    return 1e3 * (time.process_time() - begin_s) / len(epochs)


def main() -> int:
    """Print a line for each number of coils."""
    for coils in [int(word) for word in sys.argv[1:]] or SIZES:
        print(f"{coils} coils: {milliseconds(coils):.1f} ms a pose", flush=True)
    return 0


if __name__ == "__main__":
    sys.exit(main())
