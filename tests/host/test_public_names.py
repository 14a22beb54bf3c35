"""What ``import goldfield`` offers, and what it costs."""

import ast
import gc
import pickle
import subprocess
import sys
from pathlib import Path

import can
import numpy as np
import pytest

import goldfield
from goldfield.link.buses import BusSource
from tests.host.fake_sensor import SITE, heartbeat, log_of


def test_every_name_is_there_and_known_to_type_checkers():
    stub = ast.parse((Path(goldfield.__file__).parent / "__init__.pyi").read_text())
    names = {
        alias.asname: (node.module, alias.name)
        for node in stub.body
        if isinstance(node, ast.ImportFrom)
        for alias in node.names
    }
    assert {*names, "__version__"} == set(goldfield.__all__)
    for name, (module, own_name) in names.items():
        found = getattr(goldfield, name)
        told = getattr(__import__(module, fromlist=[own_name]), own_name)
        assert found is told or name == "locate"
    with pytest.raises(AttributeError, match="no attribute 'nothing'"):
        goldfield.nothing  # noqa: B018


def test_the_import_loads_nothing_heavy():
    code = "import goldfield, sys; print(*{name.split('.')[0] for name in sys.modules} & {'numpy', 'scipy', 'can'})"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout == "\n"


def test_the_command_is_there_before_anything_else_is_loaded():
    """What is loaded later can be interrupted without a traceback."""
    code = "import goldfield.cli, sys; print(*{'argparse', 'importlib.metadata', 'pathlib', 'numpy'} & {*sys.modules})"
    done = subprocess.run([sys.executable, "-I", "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout in ("\n", "pathlib\n")  # pathlib: an installation that points at the source tree


def test_locate_is_a_function_whatever_was_imported_before():
    site = goldfield.load_site(SITE)
    fields = goldfield.Fields(3, 0.3, (), np.zeros((0, 3)), np.zeros(0))
    assert goldfield.locate(site, fields).status is goldfield.Status.FAILED


def test_a_log_gives_epochs_and_counts(tmp_path):
    path = tmp_path / "a.log"
    path.write_text(log_of(range(4, 8), [heartbeat()]))
    with goldfield.open_log(path, site=SITE) as sensor:
        epochs = list(sensor.epochs())
    assert [epoch.pose.epoch for epoch in epochs] == [4, 5, 6, 7]
    assert all((epoch.lost, epoch.notes, len(epoch.fields.beacons)) == (0, (), 8) for epoch in epochs)
    assert (sensor.node, sensor.live, sensor.bad_frames, sensor.counters) == (100, False, 0, {})


BAD = [
    ({}, "no source is given: give one of port= and can="),
    ({"port": "a", "can": "b"}, "more than one source is given"),
    ({"port": "/dev/no-such-port"}, "there is no such port: check port=$"),
    ({"can": "nonsense:0"}, "^can=nonsense:0: python-can knows no interface nonsense"),
    ({"port": "a", "track": True, "on_sensor": True}, "^on_sensor= and track= are both given"),
]


@pytest.mark.parametrize(("arguments", "words"), BAD)
def test_errors_speak_of_the_arguments(arguments, words):
    with pytest.raises(goldfield.UserError, match=words):
        goldfield.connect(site=SITE, **arguments)


def test_only_public_names_are_listed():
    assert dir(goldfield) == sorted(goldfield.__all__)


def test_fields_and_poses_can_be_compared_and_kept_in_sets():
    fields = goldfield.Fields(3, 0.3, ("b1",), np.zeros((1, 3)), np.ones(1))
    poses = [goldfield.Pose.failed(fields) for _ in range(2)]
    assert poses[1] in poses
    assert poses[0] != poses[1]
    assert len({*poses, fields}) == 3


def test_locate_reaches_other_processes():
    assert pickle.loads(pickle.dumps(goldfield.locate)) is goldfield.locate


@pytest.mark.parametrize("node", [0, 4096])
def test_a_node_that_cannot_be_is_refused(tmp_path, node):
    with pytest.raises(goldfield.UserError, match=rf"^node={node}: is no node: nodes are 1 to 4095"):
        goldfield.open_log(tmp_path / "none.log", site=SITE, node=node)


def test_a_second_iterator_goes_on_and_is_empty_at_the_end(tmp_path):
    path = tmp_path / "a.log"
    path.write_text(log_of(range(4, 8), [heartbeat()]))
    with goldfield.open_log(path, site=SITE) as sensor:
        assert next(sensor.poses()).epoch == 4
        assert [pose.epoch for pose in sensor.poses()] == [5, 6, 7]
        assert list(sensor.poses()) == []


@pytest.mark.filterwarnings("error")
def test_a_closed_recording_is_not_read_on(tmp_path):
    path = tmp_path / "a.log"
    path.write_text(log_of(range(4, 8), [heartbeat()]))
    with goldfield.open_log(path, site=SITE) as sensor:
        poses = sensor.poses()
        next(poses)
    sensor.close()
    with pytest.raises(goldfield.UserError, match=r"a\.log: is closed: read it before, or open it again"):
        list(poses)
    del sensor, poses
    gc.collect()


def test_a_closed_live_sensor_is_not_waited_for():
    with can.Bus("closed", interface="virtual") as bus:
        source = BusSource(bus, "virtual")
        source.close()
        with pytest.raises(goldfield.UserError, match=r"^virtual: is closed"):
            source.receive(60.0)


@pytest.mark.parametrize(
    ("field", "sigma"), [((2, 3), (3,)), ((3, 2), (3,)), ((3,), (3,)), ((3, 3), ()), ((3, 3), (3, 3))]
)
def test_fields_of_the_wrong_shape_are_refused_in_a_sentence(field, sigma):
    with pytest.raises(
        goldfield.UserError, match=r"^(field|sigma)_T= of Fields has the shape \(.*\): 3 beacons need \("
    ):
        goldfield.Fields(0, 0.0, ("b1", "b2", "b3"), np.zeros(field), np.ones(sigma))


def test_fields_take_a_list_of_names_and_refuse_one_that_comes_twice():
    names = ["b1", "b2", "b3"]
    fields = goldfield.Fields(0, 0.0, names, np.zeros((3, 3)), np.ones(3))
    assert fields.beacons == ("b1", "b2", "b3")
    assert goldfield.locate(goldfield.load_site(SITE), fields).status == "failed"
    with pytest.raises(goldfield.UserError, match=r"^beacons= of Fields names b1 twice"):
        goldfield.Fields(0, 0.0, [*names, "b1"], np.zeros((4, 3)), np.ones(4))
