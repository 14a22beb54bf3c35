"""docs/start.md: the poses are those of the bench, live, from the recording and from the table."""

from __future__ import annotations

import json
import re
from pathlib import Path

from tests.docs.walkthrough import run_page


def test_the_page_works(tmp_path: Path) -> None:
    _, live, replayed, located = (step.printed for step in run_page("start.md", tmp_path))
    epochs, ok = map(int, re.search(r"^(\d+) epochs: (\d+) ok", live, re.M).groups())  # type: ignore[union-attr]
    assert epochs == 30
    assert ok >= 29
    poses = [line for line in live.splitlines() if line.endswith("  ok")]
    assert len(poses) == ok
    # The recording also has what came while the sensor was set up, so its first poses know more of the ambient field.
    assert set(poses[2:]) <= set(replayed.splitlines())
    statuses = [json.loads(line)["status"] for line in located.splitlines() if line.startswith("{")]
    assert statuses.count("ok") == ok
