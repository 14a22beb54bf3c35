"""A recording in MCAP, read by another program: what is in it, that it is whole at any moment, and what damages it."""

import os
import re
import struct
import subprocess
import sys
import tracemalloc

import can
import foxglove
import lz4.frame
import numpy as np
import pytest
import zstandard
from mcap.reader import SeekingReader

from goldfield import load_site, open_log
from goldfield.cli import main
from goldfield.errors import UserError
from goldfield.link import mcap_records
from goldfield.link.recordings import CandumpReader
from goldfield.recording import mcap_file as writing
from goldfield.recording.about import About, options_of
from goldfield.recording.mcap_file import McapFile
from goldfield.recording.mcap_recording import McapRecording
from goldfield.sensor.options import Method, Options
from tests.host.fake_sensor import NODE, SITE, heartbeat, log_of
from tests.host.recording.mcap_file import decoded, topics

CYCLES = 25
BEGIN_S = 1_700_000_000


@pytest.fixture(scope="module")
def recorded(tmp_path_factory):
    """Return a recording of a run, and the log that it was made of."""
    folder = tmp_path_factory.mktemp("recorded")
    log, kept = folder / "a.log", folder / "a.mcap"
    log.write_text(re.sub(r"\((\d+)", lambda s: f"({BEGIN_S + int(s[1])}", log_of(range(CYCLES), [heartbeat()])))
    assert main(["run", "--log", str(log), "--site", str(SITE), "--json", "--record", str(kept)]) == 0
    return kept, log


def test_foxglove_finds_its_own_schemas(recorded):
    kept, _ = recorded
    with kept.open("rb") as file:
        summary = SeekingReader(file).get_summary()
    schemas = {channel.topic: summary.schemas[channel.schema_id].name for channel in summary.channels.values()}
    assert schemas == {
        "/tf": "foxglove.FrameTransforms",
        "/goldfield/pose": "foxglove.PoseInFrame",
        "/goldfield/pose_covariance": "foxglove.Odometry",
        "/goldfield/scene": "foxglove.SceneUpdate",
        "/goldfield/log": "foxglove.Log",
        "/goldfield/line": "goldfield.Line",
        "/goldfield/fields": "goldfield.Fields",
        "/goldfield/health": "goldfield.Health",
        "/goldfield/parameters": "goldfield.Parameters",
        "/goldfield/can": "can_msgs/msg/Frame",
    }
    counts = {
        summary.channels[number].topic: count for number, count in summary.statistics.channel_message_counts.items()
    }
    for topic in ("/tf", "/goldfield/pose", "/goldfield/line", "/goldfield/fields"):
        assert counts[topic] == CYCLES


def test_messages_tell_the_time_of_the_measurement_and_the_file_when_they_came(recorded):
    kept, log = recorded
    with open_log(log, site=SITE) as sensor:
        epochs = list(sensor.epochs())
    placed = [(came_ns, one) for topic, came_ns, one in decoded(kept) if topic == "/goldfield/pose"]
    assert len(placed) == len(epochs)
    for (came_ns, one), epoch in zip(placed, epochs, strict=True):
        measured_s = one.timestamp.seconds + 1e-9 * one.timestamp.nanos
        p = one.pose.position
        assert (p.x, p.y, p.z) == tuple(epoch.pose.position_m)
        assert came_ns == pytest.approx(epoch.arrived_s * 1e9, abs=500)
        assert 0.04 < 1e-9 * came_ns - measured_s < 0.2  # half a cycle, and the way
    steps = np.diff([one.timestamp.seconds - BEGIN_S + 1e-9 * one.timestamp.nanos for _, one in placed])
    assert np.allclose(steps, np.diff([epoch.pose.time_s for epoch in epochs]), atol=1e-4)


def test_the_messages_of_the_link_are_those_of_the_log(recorded):
    kept, log = recorded
    frames = [one for topic, _, one in decoded(kept) if topic == "/goldfield/can"]
    wanted = list(CandumpReader(log))
    assert [(f.id, bytes(f.data[: f.dlc]), f.is_extended) for f in frames] == [
        (m.arbitration_id, bytes(m.data), m.is_extended_id) for m in wanted
    ]
    stamps = [f.header.stamp.sec + 1e-9 * f.header.stamp.nanosec for f in frames]
    assert stamps == pytest.approx([m.timestamp for m in wanted])


def test_scene_fields_and_boards_are_told(recorded):
    kept, _ = recorded
    messages = decoded(kept)
    site = load_site(SITE)
    scenes = [one for topic, _, one in messages if topic == "/goldfield/scene"]
    assert {entity.id for entity in scenes[0].entities} == {"site", *(f"beacon {b.id}" for b in site.beacons)}
    assert {entity.id for one in scenes for entity in one.entities} > {"pose"}
    told = next(one for one in reversed(scenes) if len(one.entities) > 1)
    states = [{pair.key: pair.value for pair in entity.metadata}.get("state") for entity in told.entities]
    assert states == [None, *("used" for _ in site.beacons)]
    fields = [one for topic, _, one in messages if topic == "/goldfield/fields"]
    assert [field["beacon"] for field in fields[0]["fields"]] == [beacon.id for beacon in site.beacons]
    boards = [one for topic, _, one in messages if topic == "/goldfield/parameters"]
    assert boards[-1]["nodes"][str(NODE)]["role"] == "sensor"


def test_the_run_can_be_made_again_from_the_file_alone(recorded):
    kept, _ = recorded
    with kept.open("rb") as file:
        reader = SeekingReader(file)
        (about,) = list(reader.iter_metadata())
        (attached,) = list(reader.iter_attachments())
    assert about.name == "goldfield"
    assert about.metadata["protocol"].startswith("0x")
    assert attached.data == SITE.read_bytes()
    options = Options(Method.TRACK, node=7, rate_hz=100.0, lag_s=0.05, reconnect=True)
    told = About("can x", options, load_site(SITE), str(SITE), live=True).metadata(None)
    assert options_of(told) == Options(Method.TRACK, node=7, rate_hz=100.0, lag_s=0.05)
    assert options_of({}) == Options()


def test_the_file_is_whole_after_each_flush(tmp_path, monkeypatch):
    """Whenever the program is killed, what was flushed is there, with a proper end."""
    path = tmp_path / "a.mcap"
    monkeypatch.setattr(writing, "FLUSH_S", 1e9)
    file = McapFile(path)
    sizes = []
    for number in range(4):
        for part in range(50):
            file.log("/goldfield/line", {"epoch": 50 * number + part}, 1.0 + number)
        file.flush()
        assert len(topics(path)["/goldfield/line"]) == 50 * (number + 1)
        assert path.read_bytes().endswith(writing.END)
        sizes.append(path.stat().st_size)
    file.flush()
    assert path.stat().st_size == sizes[-1]
    file.close()
    assert not path.read_bytes().endswith(writing.END)
    assert writing.END not in path.read_bytes()
    with path.open("rb") as whole:
        assert SeekingReader(whole, validate_crcs=True).get_summary().statistics.message_count == 200


def test_a_chunk_is_written_four_times_a_second():
    assert writing.FLUSH_S <= 0.25


def test_a_file_that_is_cut_off_anywhere_gives_what_came_before(tmp_path, recorded, capsys):
    kept, _ = recorded
    data = kept.read_bytes()
    wanted = [(m.arbitration_id, bytes(m.data)) for m in CandumpReader(kept)]
    cut = tmp_path / "cut.mcap"
    rng = np.random.default_rng(14)
    for length in rng.integers(len(writing.MAGIC), len(data), 60):
        cut.write_bytes(data[:length])
        assert readable(cut) == wanted[: len(readable(cut))]


def test_a_byte_that_is_changed_is_noticed(tmp_path, recorded, capsys):
    kept, _ = recorded
    data = bytearray(kept.read_bytes())
    wanted = [(m.arbitration_id, bytes(m.data)) for m in CandumpReader(kept)]
    changed = tmp_path / "changed.mcap"
    for place in np.random.default_rng(15).integers(len(writing.MAGIC), len(data), 60):
        changed.write_bytes(data[:place] + bytes([data[place] ^ 0x10]) + data[place + 1 :])
        assert readable(changed) == wanted[: len(readable(changed))]


def readable(path):
    """Return the messages of a damaged file; anything but a sentence is an error."""
    try:
        return [(m.arbitration_id, bytes(m.data)) for m in CandumpReader(path)]
    except UserError:
        return []


@pytest.mark.parametrize("content", [b"", b"\0" * 100, b"\xff" * 100])
def test_garbage_behind_the_magic_bytes_is_told(tmp_path, content):
    (tmp_path / "a.mcap").write_bytes(writing.MAGIC + content)
    with pytest.raises(UserError, match=r"a\.mcap: (is damaged or was cut off|holds no messages)"):
        list(CandumpReader(tmp_path / "a.mcap"))


def test_a_file_of_another_program_is_told_by_its_topics(tmp_path):
    context = foxglove.Context()
    with foxglove.open_mcap(tmp_path / "robot.mcap", context=context):
        for name in ("camera", "lidar"):
            foxglove.Channel(f"/{name}", context=context).log({"a": 1})
    with pytest.raises(
        UserError, match=r"robot\.mcap: holds no messages of CAN, but /camera, /lidar: give a recording"
    ):
        list(CandumpReader(tmp_path / "robot.mcap"))


FILL = """
import resource, signal, sys
signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
before = resource.getrlimit(resource.RLIMIT_FSIZE)
resource.setrlimit(resource.RLIMIT_FSIZE, (20000, before[1]))
from goldfield.recording import mcap_file
mcap_file.FLUSH_S = 1e9
file = mcap_file.McapFile(sys.argv[1])
for i in range(200):
    for j in range(50):
        file.log("/goldfield/line", {"epoch": i, "reason": str(hash((i, j)))}, i)
    file.flush()
file.close()
print("went on", file.failed)
resource.setrlimit(resource.RLIMIT_FSIZE, before)  # What measures coverage writes a file at the end.
"""


def test_a_full_disk_stops_the_recording_and_leaves_a_whole_file(tmp_path):
    path = tmp_path / "full.mcap"
    done = subprocess.run([sys.executable, "-c", FILL, path], capture_output=True, text=True, check=True)
    assert done.stdout == "went on True\n"
    assert re.fullmatch(rf"goldfield: {path}: recording stopped after \d+ bytes: .*; the run goes on\n", done.stderr)
    assert path.stat().st_size > 15000
    found = topics(path)["/goldfield/line"]
    assert len(found) > 100
    assert len(found) % 50 == 0


def test_a_recording_goes_into_a_pipe(tmp_path, recorded):
    kept, log = recorded
    pipe, piped = tmp_path / "pipe.mcap", tmp_path / "piped.mcap"
    os.mkfifo(pipe)
    with piped.open("wb") as file, subprocess.Popen(["cat", pipe], stdout=file) as reader:
        assert main(["run", "--log", str(log), "--site", str(SITE), "--json", "--record", str(pipe)]) == 0
        reader.wait()
    assert len(topics(piped)["/goldfield/line"]) == len(topics(kept)["/goldfield/line"])


def test_a_recording_that_got_nothing_is_empty(tmp_path):
    about = About("port x", Options(), load_site(SITE), str(SITE), live=True)
    recording = McapRecording(tmp_path / "a.mcap", about)
    recording.close()
    assert (tmp_path / "a.mcap").read_bytes() == b""
    recording = McapRecording(tmp_path / "a.mcap", about)
    recording.write(can.Message(timestamp=1.0, arbitration_id=5, data=b"x"))
    recording.close()
    assert len(topics(tmp_path / "a.mcap")["/goldfield/can"]) == 1


def record(opcode: int, content: bytes, length: int | None = None) -> bytes:
    """Return a record whose length is that of its content, or a lie."""
    return bytes([opcode]) + struct.pack("<Q", len(content) if length is None else length) + content


def chunk(compression: str, size: int) -> bytes:
    """Return a chunk of so many bytes, all of them zero, that says that it has a hundred."""
    packers = {"": bytes, "zstd": zstandard.ZstdCompressor().compress, "lz4": lz4.frame.compress}
    data, name = packers[compression](bytes(size)), compression.encode()
    head = struct.pack("<QQQI", 0, 0, 100, 0) + struct.pack("<I", len(name)) + name
    return record(6, head + struct.pack("<Q", len(data)) + data)


LIES = {
    "record": record(5, bytes(50), length=255 * 2**20),
    "text": record(1, struct.pack("<I", 0xFFFFFFF0) + bytes(8)),
    "zstd": chunk("zstd", 60 * 2**20),
    "lz4": chunk("lz4", 60 * 2**20),
}


@pytest.mark.parametrize("lie", LIES)
def test_a_length_that_lies_costs_no_memory(tmp_path, lie):
    """These asked for 0.25 to 4 GB, and what was packed had each of its bytes looked at."""
    path = tmp_path / "a.mcap"
    path.write_bytes(writing.MAGIC + LIES[lie])
    tracemalloc.start()
    with pytest.raises(UserError, match=r"a\.mcap: is damaged or was cut off"):
        list(CandumpReader(path))
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak < 40 * 2**20


@pytest.mark.parametrize("compression", ["", "zstd", "lz4"])
def test_a_chunk_may_be_packed_well_and_no_better(tmp_path, monkeypatch, compression):
    """The limit grows with what the file has; at it the chunk is read, which holds no message."""
    content = chunk(compression, 90_000)
    packed = len(content) - 9 - 32 - len(compression) - 8
    for most, words in ((90_000, "holds no messages"), (89_999, "is damaged")):
        monkeypatch.setattr(mcap_records, "MOST_EXPANSION", 1)
        monkeypatch.setattr(mcap_records, "FREE_EXPANSION", most - packed)
        (tmp_path / "a.mcap").write_bytes(writing.MAGIC + content + record(2, bytes(20)) + writing.MAGIC)
        with pytest.raises(UserError, match=words):
            list(CandumpReader(tmp_path / "a.mcap"))
