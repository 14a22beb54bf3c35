"""A recording opened by Foxglove's own reader, the libraries of npm that its application is made of, beside ``mcap``.

Both read every message by its schema, whole files by their index and those of a killed program without, and what they
find is laid out as Foxglove's panels want it: one tree of frames, and a scene that draws nothing twice.
"""

import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from goldfield import load_site
from goldfield.cli import main
from hil_sim.clib import ROOT
from tests.host.fake_sensor import SITE, heartbeat, log_of
from tests.host.recording.mcap_file import decoded
from tests.host.recording.test_killed import killed_run

READERS = ROOT / "build/foxglove-reader"
NODE = Path(sys.executable).with_name("node")
CYCLES = 25
SCHEMAS = {
    "/tf": ("foxglove.FrameTransforms", "protobuf"),
    "/goldfield/pose": ("foxglove.PoseInFrame", "protobuf"),
    "/goldfield/pose_covariance": ("foxglove.Odometry", "protobuf"),
    "/goldfield/scene": ("foxglove.SceneUpdate", "protobuf"),
    "/goldfield/log": ("foxglove.Log", "protobuf"),
    "/goldfield/line": ("goldfield.Line", "jsonschema"),
    "/goldfield/fields": ("goldfield.Fields", "jsonschema"),
    "/goldfield/health": ("goldfield.Health", "jsonschema"),
    "/goldfield/parameters": ("goldfield.Parameters", "jsonschema"),
    "/goldfield/can": ("can_msgs/msg/Frame", "ros2msg"),
}
FOREVER = {"seconds": 0, "nanos": 0}
"""A lifetime of a scene's entity: it stays until another of its name comes."""


def printed(program, *words):
    """Return the JSON that a program of the reader prints."""
    assert (READERS / program).exists(), "make build/foxglove-reader.stamp installs it"
    done = subprocess.run([NODE, READERS / program, *words], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout)


def opened(path):
    """Return what Foxglove's reader finds in a file."""
    return printed("read.mjs", path)


@pytest.fixture(scope="module")
def recorded(tmp_path_factory):
    folder = tmp_path_factory.mktemp("recorded")
    (folder / "a.log").write_text(log_of(range(CYCLES), [heartbeat()]))
    words = ["run", "--log", folder / "a.log", "--site", SITE, "--json", "--record", folder / "a.mcap"]
    assert main([str(word) for word in words]) == 0
    return folder / "a.mcap"


@pytest.fixture(scope="module")
def found(recorded):
    return opened(recorded)


@pytest.fixture(scope="module")
def killed(tmp_path_factory):
    """A recording of a run that was killed when it had printed so many poses, a second and more of them."""
    path = tmp_path_factory.mktemp("killed") / "a.mcap"
    killed_run(path, 150, written=True)
    return path


def plain(content):
    """Return a message, of whatever kind, as numbers, texts, lists and dicts."""
    if hasattr(content, "DESCRIPTOR"):
        fields = content.DESCRIPTOR.fields
        return {field.name: None if absent(content, field) else plain(getattr(content, field.name)) for field in fields}
    if hasattr(content, "__slots__") and not isinstance(content, (dict, list)):
        return {name.lstrip("_"): plain(getattr(content, name)) for name in content.__slots__}
    if isinstance(content, bytes):
        return list(content)
    if isinstance(content, (list, tuple)) or type(content).__name__.startswith("Repeated"):
        return [plain(one) for one in content]
    return content


def told(content):
    """Return a message without what is not in it: one reader has null there, the other one nothing."""
    if isinstance(content, dict):
        return {name: told(value) for name, value in content.items() if value is not None}
    return [told(one) for one in content] if isinstance(content, list) else content


def absent(message, field):
    return field.message_type is not None and not field.is_repeated and not message.HasField(field.name)


def the_same(found, path):
    """Check that both readers find the same messages at the same times; return how many."""
    ours = {}
    for topic, log_time, content in decoded(path):
        ours.setdefault(topic, []).append((str(log_time), plain(content)))
    theirs = {topic: [(m["logTime"], m["content"]) for m in one["messages"]] for topic, one in found["topics"].items()}
    assert set(theirs) == set(ours) == set(SCHEMAS)
    for topic, messages in ours.items():
        bare = told if SCHEMAS[topic][1] == "protobuf" else (lambda content: content)
        assert [(time, bare(one)) for time, one in theirs[topic]] == [(time, bare(one)) for time, one in messages], (
            topic
        )
    return {topic: len(messages) for topic, messages in ours.items()}


def test_every_message_is_read_by_its_schema_and_the_index(found, recorded):
    counts = the_same(found, recorded)
    assert {topic: (one["schema"], one["schemaEncoding"]) for topic, one in found["topics"].items()} == SCHEMAS
    assert "notIndexed" not in found
    assert found["chunks"] >= 1
    assert {topic: found["counts"][str(one["id"])] for topic, one in found["topics"].items()} == counts
    assert found["metadata"] == ["goldfield"]
    assert found["attachments"] == [{"name": "site.toml", "text": SITE.read_text()}]


def test_a_recording_of_a_killed_run_is_read_to_its_end_without_an_index(killed):
    found = opened(killed)
    assert "not indexed" in found["notIndexed"]
    assert found["ended"] is True
    assert the_same(found, killed)["/goldfield/line"] > 1
    assert found["metadata"] == ["goldfield"]
    assert [one["name"] for one in found["attachments"]] == ["site.toml"]


def test_a_recording_that_is_torn_is_read_up_to_there(killed, tmp_path):
    whole, data = opened(killed), killed.read_bytes()
    (tmp_path / "torn.mcap").write_bytes(data[: len(data) // 2])
    torn = opened(tmp_path / "torn.mcap")
    assert torn["ended"] is False
    lines, all_lines = (one["topics"].get("/goldfield/line", {"messages": []})["messages"] for one in (torn, whole))
    assert lines == all_lines[: len(lines)]
    assert len(lines) < len(all_lines)


def of(found, topic):
    return [message["content"] for message in found["topics"][topic]["messages"]]


def test_every_frame_hangs_on_one_tree(found):
    """Foxglove draws what is in a frame only if transforms lead from there to the frame that is followed."""
    transforms = [one for message in of(found, "/tf") for one in message["transforms"]]
    parents = {one["child_frame_id"]: one["parent_frame_id"] for one in transforms}
    assert parents == {"sensor": "map"}
    named = {entity["frame_id"] for scene in of(found, "/goldfield/scene") for entity in scene["entities"]}
    named |= {
        message["frame_id"] for topic in ("pose", "pose_covariance") for message in of(found, f"/goldfield/{topic}")
    }
    named |= {message["body_frame_id"] for message in of(found, "/goldfield/pose_covariance")}
    assert named == {"map", "sensor"}


def test_coils_stay_until_they_are_told_anew_and_the_ellipsoid_goes_without_poses(found):
    scenes = of(found, "/goldfield/scene")
    site = load_site(SITE)
    lifetimes = {}
    for scene in scenes:
        ids = [entity["id"] for entity in scene["entities"]]
        assert len(set(ids)) == len(ids)
        assert scene["deletions"] == []
        for entity in scene["entities"]:
            assert entity["frame_locked"] is False
            assert lifetimes.setdefault(entity["id"], entity["lifetime"]) == entity["lifetime"]
    pose = lifetimes.pop("pose")
    assert (pose["seconds"], pose["nanos"]) == (1, 0)
    assert set(lifetimes) == {"site", *(f"beacon {beacon.id}" for beacon in site.beacons)}
    assert all(one == FOREVER for one in lifetimes.values())
    drawn = [n for n, scene in enumerate(scenes) if any(entity["id"] == "site" for entity in scene["entities"])]
    assert len(drawn) > 2, "who jumps in the file finds the coils again"


def test_places_are_metres_and_turns_unit_quaternions(found):
    """A coil's line is where the site file has the coil, and the sensor within its box."""
    site = load_site(SITE)
    entities = {entity["id"]: entity for entity in of(found, "/goldfield/scene")[0]["entities"]}
    for beacon in site.beacons:
        (line,) = entities[f"beacon {beacon.id}"]["lines"]
        points = np.array([[point[axis] for axis in "xyz"] for point in line["points"]])
        assert np.allclose(points[:-1].mean(axis=0), beacon.position_m, atol=1e-6)
    for message in of(found, "/tf"):
        (transform,) = message["transforms"]
        assert np.linalg.norm([transform["rotation"][axis] for axis in "xyzw"]) == pytest.approx(1.0)
        assert all(-1.0 < transform["translation"][axis] < 3.0 for axis in "xyz")


def test_the_log_panel_gets_level_time_name_and_sentence(found):
    (first, *_) = of(found, "/goldfield/log")
    assert (first["level"], first["name"]) == (2, "goldfield")
    assert first["message"].startswith("ok")
    assert first["timestamp"]["seconds"] >= 0


KINDS = {"number": (int, float), "integer": (int,), "string": (str,), "boolean": (bool,), "object": (dict,)}
"""What JSON schemas call what a reader of protobuf gives."""


def faults(value, schema, path):
    """Yield where a message is not what a published schema says, to the letter; times are protobuf's own."""
    if schema.get("title") in ("time", "duration"):
        if value is None or set(value) != {"seconds", "nanos"} or not 0 <= value["nanos"] < 1_000_000_000:
            yield f"{path}: {value} is no time"
    elif "oneOf" in schema:
        if value not in [one["const"] for one in schema["oneOf"]]:
            yield f"{path}: {value} is none of the choices"
    elif schema["type"] == "array":
        for one in value:
            yield from faults(one, schema["items"], f"{path}[]")
    elif type(value) not in KINDS[schema["type"]]:
        yield f"{path}: {value!r} is no {schema['type']}"
    elif schema["type"] == "object":
        properties, required = schema["properties"], set(schema.get("required", ()))
        if set(value) - set(properties) or required - set(value):
            yield f"{path}: has {sorted(value)}, wanted are {sorted(properties)}"
        for name in set(value) & set(properties):
            if value[name] is not None or name in required:
                yield from faults(value[name], properties[name], f"{path}.{name}")


@pytest.fixture(scope="module")
def published():
    """The schemas of the package that Foxglove publishes, by name."""
    return printed("schemas.mjs")


def test_every_message_is_to_the_letter_what_foxglove_publishes(found, published):
    """Names, kinds, choices, and all that is required, though the application forgives what is not there."""
    own = {topic: one for topic, one in found["topics"].items() if one["schema"].startswith("foxglove.")}
    assert len(own) == 5
    for one in own.values():
        schema = published[one["schema"]]
        assert {fault for m in one["messages"] for fault in faults(m["content"], schema, one["schema"])} == set()


@pytest.mark.parametrize(
    "wrong",
    [
        {"frame_id": None},
        {"frame_id": 3},
        {"level": 6},
        {"timestamp": None},
        {"timestamp": {"sec": 1, "nsec": 0}},
        {"more": 1},
    ],
)
def test_the_letter_is_judged(found, published, wrong):
    topic = "/goldfield/log" if "level" in wrong else "/goldfield/pose"
    one = found["topics"][topic]
    content = one["messages"][0]["content"] | wrong
    assert len(list(faults(content, published[one["schema"]], ""))) == 1
