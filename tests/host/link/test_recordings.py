"""Recorded logs: read, written, torn and on a full disk."""

import re
import subprocess
import sys

import can
import pytest
from hypothesis import given
from hypothesis import strategies as st

from goldfield.errors import UserError
from goldfield.link.recordings import CandumpReader, CandumpWriter
from goldfield.link.traffic import CORRUPT

MESSAGES = [
    can.Message(timestamp=1795371886.387772, arbitration_id=0x08000064, data=bytes(range(8))),
    can.Message(timestamp=1795371886.4, arbitration_id=0x1FFFFFFF, data=b""),
]


def key(message):
    return round(message.timestamp, 6), message.arbitration_id, bytes(message.data), message.is_extended_id


def write(path, messages):
    writer = CandumpWriter(path)
    for message in messages:
        writer.write(message)
    writer.close()


def test_what_is_written_is_read_again_here_and_by_python_can(tmp_path):
    write(tmp_path / "a.log", MESSAGES)
    assert [key(m) for m in CandumpReader(tmp_path / "a.log")] == [key(m) for m in MESSAGES]
    assert [key(m) for m in can.LogReader(tmp_path / "a.log")] == [key(m) for m in MESSAGES]


def test_what_python_can_writes_is_read(tmp_path):
    with can.CanutilsLogWriter(tmp_path / "b.log", channel="vcan0") as writer:
        for message in MESSAGES:
            writer.on_message_received(message)
    assert [key(m) for m in CandumpReader(tmp_path / "b.log")] == [key(m) for m in MESSAGES]


@given(st.binary(max_size=300))
def test_garbage_costs_only_its_lines(tmp_path_factory, garbage):
    path = tmp_path_factory.mktemp("log") / "c.log"
    write(path, MESSAGES)
    path.write_bytes(path.read_bytes() + garbage + b"\n" + path.read_bytes())
    reader = CandumpReader(path)
    read = [key(m) for m in reader]
    assert read[:2] == [key(m) for m in MESSAGES]
    assert read[-2:] == [key(m) for m in MESSAGES]
    assert reader.traffic[CORRUPT] >= (len(read) == 4 and bool(garbage.strip()))


def test_a_torn_last_line_is_counted(tmp_path):
    path = tmp_path / "d.log"
    write(path, MESSAGES)
    path.write_bytes(path.read_bytes()[:-20])
    reader = CandumpReader(path)
    assert [key(m) for m in reader] == [key(MESSAGES[0])]
    assert reader.traffic[CORRUPT] == 1


@pytest.mark.parametrize(
    "content", [b"", b"\n\n", b"\x00\xff" * 5000, b"time,id,data\n1,2,3\n", b"(1.0) can0 123#00\n"]
)
def test_what_holds_no_message_is_refused(tmp_path, content):
    (tmp_path / "e.log").write_bytes(content)
    with pytest.raises(UserError, match="holds no message"):
        list(CandumpReader(tmp_path / "e.log"))


def test_paths_that_are_no_log(tmp_path):
    with pytest.raises(UserError, match="no such log"):
        CandumpReader(tmp_path / "none")
    with pytest.raises(UserError, match="is a directory"):
        CandumpReader(tmp_path)
    with pytest.raises(UserError, match="the recording cannot be written"):
        CandumpWriter(tmp_path / "none" / "x.log")
    with pytest.raises(UserError, match="the recording cannot be written"):
        CandumpWriter(tmp_path)


def test_a_recording_is_never_overwritten(tmp_path):
    write(tmp_path / "f.log", MESSAGES)
    with pytest.raises(UserError, match="not empty"):
        CandumpWriter(tmp_path / "f.log")
    assert len(list(CandumpReader(tmp_path / "f.log"))) == 2


FILL = """
import resource, signal, sys
signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
before = resource.getrlimit(resource.RLIMIT_FSIZE)
resource.setrlimit(resource.RLIMIT_FSIZE, (500, before[1]))
import can
from goldfield.link.recordings import CandumpWriter
writer = CandumpWriter(sys.argv[1])
for i in range(100):
    writer.write(can.Message(timestamp=i, arbitration_id=i, data=bytes(8)))
print("went on", writer.failed)
resource.setrlimit(resource.RLIMIT_FSIZE, before)  # What measures coverage writes a file at the end.
"""


def test_a_full_disk_stops_the_recording_but_neither_the_run_nor_what_was_written(tmp_path):
    path = tmp_path / "g.log"
    done = subprocess.run([sys.executable, "-c", FILL, path], capture_output=True, text=True, check=True)
    assert done.stdout == "went on True\n"
    assert re.fullmatch(rf"goldfield: {path}: recording stopped after \d+ bytes: .*; the run goes on\n", done.stderr)
    assert path.read_bytes().endswith(b"\n")
    reader = CandumpReader(path)
    assert [m.arbitration_id for m in reader] == list(range(len(path.read_bytes().splitlines())))
    assert path.stat().st_size > 400
    assert reader.traffic[CORRUPT] == 0


def test_a_message_is_in_the_file_as_soon_as_it_is_written(tmp_path):
    writer = CandumpWriter(tmp_path / "h.log")
    writer.write(MESSAGES[0])
    assert (tmp_path / "h.log").stat().st_size == len("(1795371886.387772) goldfield 08000064#0001020304050607\n")
    writer.close()
