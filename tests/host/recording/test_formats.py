"""A run is recorded in the format that the name tells, and each gives its lines again."""

import json
import os
import struct
import sys
import threading

import can
import pytest

from goldfield import load_site
from goldfield.cli import main
from goldfield.errors import UserError
from goldfield.link import log_writers
from goldfield.link.log_writers import BlfWriter
from goldfield.link.marks import mark
from goldfield.link.recording_file import FLUSH_S
from goldfield.link.recordings import CandumpReader
from goldfield.recording.about import About
from goldfield.recording.formats import open_recording
from goldfield.sensor.options import Options
from tests.host.fake_sensor import SITE, log_of
from tests.host.recording.mcap_file import topics

CYCLES = 6


@pytest.fixture
def about():
    return About("port /dev/ttyUSB0", Options(), load_site(SITE), str(SITE), live=False)


@pytest.mark.parametrize("name", ["a.mcap", "a.asc", "a.blf", "a.log", "a.MCAP", "a", "-.log"])
def test_a_recording_of_each_format_gives_the_lines_of_the_run(tmp_path, capsys, name):
    source, kept = tmp_path / "source.log", tmp_path / name
    source.write_text(log_of(range(CYCLES)))
    assert main(["run", "--log", str(source), "--site", str(SITE), "--json", "--record", str(kept)]) == 0
    first = capsys.readouterr().out
    assert len(first.splitlines()) == CYCLES
    assert main(["run", "--log", str(kept), "--site", str(SITE), "--json"]) == 0
    assert capsys.readouterr().out == first


@pytest.mark.parametrize("ending", [".mcap", ".asc", ".blf", ".log"])
def test_every_message_and_mark_comes_back(tmp_path, about, ending):
    messages = [
        mark(100, 1_700_000_000.25),
        can.Message(timestamp=1_700_000_000.25, arbitration_id=0x08000064, data=bytes(range(8)), channel="can0"),
        can.Message(timestamp=1_700_000_000.5, arbitration_id=0x1FFFFFFF, data=b"", channel="can0"),
        mark(None, 1_700_000_001.0),
    ]
    writer = open_recording(tmp_path / f"a{ending}", about)
    for message in messages:
        writer.write(message)
    writer.close()
    assert not writer.failed
    found = list(CandumpReader(tmp_path / f"a{ending}"))
    assert [key(message) for message in found] == [key(message) for message in messages]
    if ending in (".mcap", ".log"):
        assert [message.timestamp for message in found] == [message.timestamp for message in messages]


def key(message):
    return message.arbitration_id, bytes(message.data), message.is_extended_id, message.is_remote_frame


@pytest.mark.parametrize("name", ["a.blf", "a.asc"])
def test_other_programs_read_the_logs(tmp_path, about, name):
    writer = open_recording(tmp_path / name, about)
    wanted = [can.Message(timestamp=1_700_000_000.0 + i, arbitration_id=i, data=bytes([i % 256])) for i in range(300)]
    for message in wanted:
        writer.write(message)
    writer.close()
    found = list(can.LogReader(tmp_path / name, relative_timestamp=False))
    assert [key(message) for message in found] == [key(message) for message in wanted]
    assert [round(message.timestamp, 5) for message in found] == [message.timestamp for message in wanted]


def written(path, numbers):
    """Begin a .blf with so many messages, and return its writer."""
    writer = BlfWriter(path)
    for i in numbers:
        writer.write(can.Message(timestamp=float(i), arbitration_id=i, data=bytes(8)))
    return writer


def readable(path):
    """Return the identifiers in a file as it is now: a killed program would leave it so."""
    return [message.arbitration_id for message in CandumpReader(path)]


def test_a_blf_that_is_cut_off_has_all_but_its_last_container(tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(log_writers, "FLUSH_S", 1e9)
    writer = written(tmp_path / "a.blf", range(1000))
    found = readable(tmp_path / "a.blf")
    assert found == list(range(len(found)))
    assert 900 < len(found) < 1000
    writer.close()
    assert readable(tmp_path / "a.blf") == list(range(1000))


def test_a_blf_of_which_a_part_is_missing_is_told_and_a_whole_one_is_not(tmp_path, capsys):
    """python-can takes a container that is cut off for a whole one, and the end of the file for its end."""
    written(tmp_path / "a.blf", range(300)).close()
    whole = (tmp_path / "a.blf").read_bytes()
    starts = [at for at in range(len(whole)) if whole[at : at + 4] == b"LOBJ"]
    border = next(at for at in starts if at > len(whole) // 2)
    padding = len(whole) - starts[-1] - struct.unpack_from("<I", whole, starts[-1] + 8)[0]
    assert 0 <= padding <= 3
    cut = tmp_path / "cut.blf"
    for length, missing in (
        (len(whole), False),
        (border, True),
        (border + 7, True),
        (border + 16, True),
        (border + 400, True),
        (len(whole) - padding - 1, True),
    ):
        cut.write_bytes(whole[:length])
        found = readable(cut)
        said = capsys.readouterr().err
        assert found == list(range(len(found)))
        assert ("cut.blf: is damaged or was cut off behind" in said) is missing, length
        assert missing or len(found) == 300


def test_a_blf_has_everything_after_each_flush(tmp_path, monkeypatch, capsys):
    """The containers that are not full may end anywhere: python-can cuts messages in two at the end of a full one."""
    monkeypatch.setattr(log_writers, "FLUSH_S", 1e9)
    writer = written(tmp_path / "a.blf", [])
    count = 0
    for more in (1, 3, 84, 85, 86, 200, 0, 5):
        for i in range(count, count + more):
            writer.write(can.Message(timestamp=float(i), arbitration_id=i, data=bytes(8)))
        count += more
        writer.flush()
        assert readable(tmp_path / "a.blf") == list(range(count))
    writer.close()
    found = [m.arbitration_id for m in can.LogReader(tmp_path / "a.blf", relative_timestamp=False)]
    assert found == list(range(count))


def test_a_blf_is_flushed_though_no_message_follows(tmp_path, monkeypatch, capsys):
    assert FLUSH_S <= 0.25
    flushed, flush = threading.Semaphore(0), BlfWriter.flush
    monkeypatch.setattr(log_writers, "FLUSH_S", 0.001)
    monkeypatch.setattr(BlfWriter, "flush", lambda self: (flush(self), flushed.release()))
    writer = written(tmp_path / "a.blf", range(3))
    while flushed.acquire(blocking=False):
        pass
    for _ in range(2):  # the first of them may have begun before the last message came
        assert flushed.acquire(timeout=60.0)
    assert readable(tmp_path / "a.blf") == [0, 1, 2]
    writer.close()


def test_a_pipe_that_nobody_reads_any_more_is_told_by_the_next_message(tmp_path, monkeypatch):
    monkeypatch.setattr(log_writers, "FLUSH_S", 1e9)
    os.mkfifo(tmp_path / "a.blf")
    reader = os.open(tmp_path / "a.blf", os.O_RDONLY | os.O_NONBLOCK)
    writer = written(tmp_path / "a.blf", [1])
    os.close(reader)
    writer.flush()
    with pytest.raises(BrokenPipeError):
        writer.write(can.Message(timestamp=2.0, arbitration_id=2, data=bytes(8)))


@pytest.mark.parametrize("name", ["a.csv", "a.DB", "a.log.gz", "a.mf4", "a.trc"])
def test_what_is_only_read_is_refused(tmp_path, about, name):
    with pytest.raises(UserError, match=r"is read and not written: give a name that ends in \.mcap, \.log, \.asc or"):
        open_recording(tmp_path / name, about)
    assert not (tmp_path / name).exists()


@pytest.mark.parametrize("ending", [".mcap", ".asc", ".blf", ".log"])
def test_no_recording_replaces_one_unasked(tmp_path, about, ending):
    path = tmp_path / f"a{ending}"
    path.write_bytes(b"old")
    with pytest.raises(UserError, match="not empty"):
        open_recording(path, about)
    writer = open_recording(path, about, force=True)
    assert path.read_bytes() == b"old"
    writer.close()
    assert path.read_bytes() == b"old"
    writer = open_recording(path, about, force=True)
    writer.write(can.Message(timestamp=1.0, arbitration_id=5, data=b"x"))
    writer.close()
    assert [message.arbitration_id for message in CandumpReader(path)] == [5]


def test_a_package_that_is_missing_is_told_when_a_recording_begins(tmp_path, about, monkeypatch):
    for name in [name for name in sys.modules if name.startswith(("goldfield.foxglove", "goldfield.recording.mcap"))]:
        monkeypatch.delitem(sys.modules, name)
    monkeypatch.setitem(sys.modules, "foxglove", None)
    with pytest.raises(UserError, match=r"a\.mcap: .* needs the package foxglove-sdk: .*'goldfield\[mcap\]'"):
        open_recording(tmp_path / "a.mcap", about)


def test_a_package_that_is_missing_is_told_when_a_recording_is_read(tmp_path, about, monkeypatch):
    writer = open_recording(tmp_path / "a.mcap", about)
    writer.write(can.Message(timestamp=1.0, arbitration_id=5, data=b"x"))
    writer.close()
    monkeypatch.setitem(sys.modules, "mcap.stream_reader", None)
    with pytest.raises(UserError, match=r"a\.mcap: an MCAP file needs the package mcap: .*'goldfield\[mcap\]'"):
        list(CandumpReader(tmp_path / "a.mcap"))


def test_a_line_of_the_recording_has_the_keys_of_the_run_and_its_times(tmp_path, capsys):
    source, kept = tmp_path / "source.log", tmp_path / "a.mcap"
    source.write_text(log_of(range(CYCLES)))
    assert main(["run", "--log", str(source), "--site", str(SITE), "--json", "--record", str(kept)]) == 0
    printed = [json.loads(line) for line in capsys.readouterr().out.splitlines()]
    kept_lines = [json.loads(message.data) for message in topics(kept)["/goldfield/line"]]
    assert [{key: line[key] for key in line if key not in ("unix_s", "latency_s")} for line in kept_lines] == printed
