"""Print how long ``goldfield --help`` takes beside ``import numpy``: user time of the process, in pairs.

``python tests/bench/start_up.py``; the goal is a ratio of at most 1.5.
"""

import resource
import statistics
import subprocess
import sys
from pathlib import Path

PAIRS = 15
GOLDFIELD = [str(Path(sys.executable).with_name("goldfield")), "--help"]
NUMPY = [sys.executable, "-c", "import numpy"]


def user_s(command):
    """Return the user time of a command that ends well."""
    before = resource.getrusage(resource.RUSAGE_CHILDREN).ru_utime
    subprocess.run(command, check=True, stdout=subprocess.DEVNULL)
    return resource.getrusage(resource.RUSAGE_CHILDREN).ru_utime - before


def main():
    """Run both commands in turn and print the median of the ratios."""
    pairs = [(user_s(GOLDFIELD), user_s(NUMPY)) for _ in range(1 + PAIRS)][1:]  # the first pair fills caches
    ratio = statistics.median(ours / numpys for ours, numpys in pairs)
    ours, numpys = (statistics.median(times) for times in zip(*pairs, strict=True))
    print(
        f"goldfield --help: {ours * 1e3:.0f} ms of user time, import numpy: {numpys * 1e3:.0f} ms; "
        f"ratio {ratio:.2f} (median of {PAIRS} pairs; goal: at most 1.5)"
    )


if __name__ == "__main__":
    main()
