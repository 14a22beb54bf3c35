"""A hardware-in-the-loop test of one's own: firmware, field, link and location, judged by the simulator's truth.

``pytest -p hil_sim.pytest_plugin --goldfield-rig host test_my_robot.py`` runs it on boards compiled for this machine;
without ``--goldfield-rig`` on emulated ones, with ``--goldfield-rig serial:PATH --goldfield-site SITE.toml`` on real
ones. In place of ``prigge8`` give the path of a scenario of your own.
"""

import numpy as np

import goldfield


def test_ten_poses_within_three_centimetres(open_bench):
    """Ten code cycles in a row are located near the truth."""
    bench = open_bench("prigge8")
    epochs = bench.fields(10)
    truth = bench.truth()  # by cycle; empty on a real bench, where nobody knows it
    assert len(epochs) == 10
    for fields in epochs:
        pose = goldfield.locate(bench.site, fields)
        assert pose.status is goldfield.Status.OK
        if truth:
            assert np.linalg.norm(pose.position_m - truth[pose.epoch].position_m) < 0.03
