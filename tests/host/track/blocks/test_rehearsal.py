"""What is used once before a live sensor's first block is there."""

from __future__ import annotations

import subprocess
import sys
from dataclasses import replace

import numpy as np
import pytest

from goldfield.errors import UserError
from goldfield.sensor import opening
from goldfield.sensor.options import Method, Options
from goldfield.track.blocks import rehearsal
from goldfield.track.blocks.rehearsal import rehearse
from goldfield.types import Status
from hil_sim.clib import ROOT
from tests.bench.locate_trials import prigge_cube

FIRST_BLOCKS = """
import sys
import numpy as np
from goldfield.locate import kernel
from goldfield.track.blocks import BlockFilter
from goldfield.track.blocks.kernel import library
from goldfield.track.blocks.rehearsal import rehearse
from tests.bench.locate_trials import prigge_cube
from tests.bench.rate_world import World, motion_of

site = prigge_cube(2e-7)
track = World(site).motion_track(motion_of("1 m/s, 1 rad/s", 1), 0.15, np.random.default_rng(2), 2e-7)


def read():
    return len(kernel.library.ffi._parsed_types) + len(library.ffi._parsed_types)


if "rehearsed" in sys.argv:
    rehearse(site)
follower = BlockFilter(site)
modules, types = set(sys.modules), read()
poses = [follower.update(block) for _, block in track.blocks()]
print(poses[-1].status, len(set(sys.modules) - modules), read() - types)
"""


def of_first_blocks(*words):
    """Return the status of the last pose, how many modules the first blocks import, and how many C types they read."""
    command = [sys.executable, "-c", FIRST_BLOCKS, *words]
    done = subprocess.run(command, capture_output=True, text=True, check=True, cwd=ROOT)
    return done.stdout.split()


def test_behind_a_rehearsal_the_first_blocks_do_nothing_for_the_first_time():
    assert of_first_blocks("rehearsed") == ["ok", "0", "0"]
    status, _, types = of_first_blocks()
    assert status == "ok"
    assert int(types) > 0


def test_a_rehearsal_follows_a_sensor_beside_a_coil_and_one_among_all():
    poses = rehearse(prigge_cube(2e-7))
    assert poses[rehearsal.BEGINNING].status in (Status.OK, Status.UNVERIFIED)
    assert poses[-1].status is Status.OK
    beside, among = poses[rehearsal.BEGINNING - 1], poses[-1]
    assert beside.position_m == pytest.approx(rehearsal.BESIDE_M, abs=0.2)
    # prigge_cube: coils on the corners of 2.13 m, the upper ones 1.78 m above the others
    expected = np.array([1.065, 1.065, 0.89]) + 2.13 * rehearsal.OUTSIDE
    assert among.position_m == pytest.approx(expected, abs=5.0 * np.sqrt(np.trace(among.position_cov_m2)))


def test_a_site_that_no_blocks_are_followed_on_is_not_rehearsed():
    site = prigge_cube(2e-7)
    assert rehearse(replace(site, sensor=replace(site.sensor, lever_m=np.eye(3)))) == []


def test_a_live_sensor_that_is_tracked_is_rehearsed_before_its_link_is_opened(monkeypatch):
    done = []
    monkeypatch.setattr(rehearsal, "rehearse", lambda site: done.append("rehearsed"))
    monkeypatch.setattr(opening, "open_source", lambda *_: done.append("opened") or refuse())

    def refuse():
        raise UserError("the link is not there")

    for kind, method in (("port", Method.TRACK), ("port", Method.EACH), ("log", Method.TRACK)):
        with pytest.raises(UserError, match="not there"):
            opening.open_sensor(kind, "nowhere", prigge_cube(2e-7), Options(method))
    assert done == ["rehearsed", "opened", "opened", "opened"]
