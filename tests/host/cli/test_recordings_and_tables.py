"""A recording with restarts, wraps and another day in it becomes a table of fields that gives the same poses."""

import json

import numpy as np
import pytest

from goldfield.cli import main
from tests.host.fake_sensor import SITE, heartbeat, log_of

DAYS = {
    "a restart": (log_of(range(40, 43), [heartbeat()]), log_of(range(3), [heartbeat(state=0)])),
    "the same recording twice": (log_of(range(40, 43)), log_of(range(40, 43), [heartbeat(state=0)])),
    "a wrap of the number": (log_of(range(2**20 - 2, 2**20)), log_of(range(2))),
    "time stamps that step back and forth": tuple(
        log_of([cycle]).replace("(", f"({step}") for cycle, step in zip(range(5), (9, 1, 8, 2, 7), strict=True)
    ),
}


def lines(capsys, words):
    assert main([str(word) for word in words]) == 0
    return [json.loads(line) for line in capsys.readouterr().out.splitlines()]


@pytest.mark.parametrize("name", DAYS)
def test_the_table_of_a_recording_is_read_and_gives_its_poses(tmp_path, capsys, name):
    log, table = tmp_path / "a.log", tmp_path / "fields.csv"
    log.write_text("".join(DAYS[name]))
    live = lines(capsys, ["run", "--site", SITE, "--log", log, "--fields", table, "--json"])
    located = lines(capsys, ["locate", "--site", SITE, table, "--json"])
    whole = [pose for pose in live if pose["position_m"] is not None]
    assert len(whole) >= 4
    assert [pose["epoch"] for pose in located] == [pose["epoch"] for pose in whole]
    for one, other in zip(located, whole, strict=True):
        np.testing.assert_allclose(one["position_m"], other["position_m"], atol=1e-9)
        np.testing.assert_allclose(one["orientation_xyzw"], other["orientation_xyzw"], atol=1e-9)


def test_the_same_recording_in_every_format_gives_the_same_poses(tmp_path, capsys):
    log = tmp_path / "a.log"
    log.write_text(log_of(range(4)))
    wanted = lines(capsys, ["run", "--site", SITE, "--log", log, "--json"])
    printed = [line.replace("#", "   [8]  ").split("  ") for line in log.read_text().splitlines()]
    spaced = [f"{head}  {size} {' '.join(data[i : i + 2] for i in range(0, 16, 2))}" for head, size, data in printed]
    (tmp_path / "console.log").write_bytes("\r\n".join(spaced).encode("utf-16"))
    assert lines(capsys, ["run", "--site", SITE, "--log", tmp_path / "console.log", "--json"]) == wanted
