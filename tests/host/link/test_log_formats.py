"""Recordings in the spellings of candump and the formats of python-can: each gives the same messages."""

import gzip
import importlib.util
import itertools
import re
import subprocess
import sys

import can
import pytest

from goldfield.errors import UserError
from goldfield.link.candump import parse
from goldfield.link.log_formats import DAMAGE, frames
from goldfield.link.marks import is_mark, mark, reads
from goldfield.link.recordings import CandumpReader
from goldfield.link.traffic import CORRUPT, ELEVEN_BIT, ERROR, FD, REMOTE
from tests.host.fake_sensor import SITE, cycle_messages, heartbeat

START_S = 1795817432.676801
FRAMES = [heartbeat(), *cycle_messages(124), *cycle_messages(125)]
MESSAGES = [
    can.Message(timestamp=START_S + 0.001 * place, arbitration_id=identifier, data=data, channel=0)
    for place, (identifier, data) in enumerate(FRAMES)
]
WANTED = [(m.arbitration_id, bytes(m.data)) for m in MESSAGES]


def read(path):
    reader = CandumpReader(path)
    messages = list(reader)
    return reader, [(m.arbitration_id, bytes(m.data)) for m in messages]


def counted(reader):
    return {kind: count for kind, count in reader.traffic.items() if count}


def hex_of(message, separator=""):
    return separator.join(f"{byte:02X}" for byte in message.data)


def printed(message, time):
    return f" {time}  can0  {message.arbitration_id:08X}   [{len(message.data)}]  {hex_of(message, ' ')}"


SPELLINGS = {
    "-L": lambda m, t: f"({t:.6f}) can0 {m.arbitration_id:08X}#{hex_of(m)}",
    "-l with directions": lambda m, t: f"({t:.6f}) can0 {m.arbitration_id:08X}#{hex_of(m)} R",
    "dots between bytes": lambda m, t: f"({t:.6f}) can0 {m.arbitration_id:08X}#{hex_of(m, '.')}",
    "raw length": lambda m, t: f"({t:.6f}) can0 {m.arbitration_id:08X}#{hex_of(m)}{'_9' if len(m.data) == 8 else ''}",
    "identifiers without zeros": lambda m, t: f"({t:.6f}) can0 {m.arbitration_id:X}#{hex_of(m)}",
    "small letters": lambda m, t: f"({t:.6f}) can0 {m.arbitration_id:08x}#{hex_of(m).lower()}",
    "-ta": lambda m, t: printed(m, f"({t:.6f})"),
    "-tz": lambda m, t: printed(m, f"({t - START_S:010.6f})"),
    "-td": lambda m, _: printed(m, "(000.001000)"),
    "-tA": lambda m, t: printed(m, f"(2026-11-27 14:10:{t - START_S + 32:09.6f})"),
    "no time": lambda m, _: printed(m, ""),
    "-x": lambda m, t: printed(m, f"({t:.6f})").replace("can0  ", "can0  RX - -  "),
    "-a": lambda m, t: printed(m, f"({t:.6f})") + "   '........'",
    "-c": lambda m, t: f"\x1b[1m{printed(m, f'({t:.6f})')}\x1b[0m",
    "-8": lambda m, t: re.sub(r"\[(\d)\]", r"{\1}", printed(m, f"({t:.6f})")),
}


@pytest.mark.parametrize("spelling", SPELLINGS)
def test_every_spelling_of_candump_gives_the_same_messages(tmp_path, capsys, spelling):
    path = tmp_path / "a.log"
    path.write_text("".join(SPELLINGS[spelling](m, m.timestamp) + "\n" for m in MESSAGES))
    reader, found = read(path)
    assert found == WANTED
    assert (counted(reader), capsys.readouterr().err) == ({}, "")


LOGGED = "".join(SPELLINGS["-L"](m, m.timestamp) + "\n" for m in MESSAGES)
ENCODINGS = {
    "byte order mark": LOGGED.encode("utf-8-sig"),
    "UTF-16": LOGGED.encode("utf-16"),
    "UTF-16, big end first": b"\xfe\xff" + LOGGED.encode("utf-16-be"),
    "CRLF": LOGGED.replace("\n", "\r\n").encode(),
    "packed": gzip.compress(LOGGED.encode()),
    "no last line end": LOGGED.rstrip().encode(),
}


@pytest.mark.parametrize("encoding", ENCODINGS)
@pytest.mark.parametrize("name", ["a.log", "a.txt", "a.blf"])
def test_every_encoding_under_any_name(tmp_path, encoding, name):
    (tmp_path / name).write_bytes(ENCODINGS[encoding])
    reader, found = read(tmp_path / name)
    assert found == WANTED
    assert counted(reader) == {}


HAS_ASAMMDF = importlib.util.find_spec("asammdf") is not None
MF4 = pytest.param(".mf4", marks=pytest.mark.skipif(not HAS_ASAMMDF, reason="asammdf (the extra mf4) is not installed"))


@pytest.mark.parametrize("suffix", [".asc", ".blf", ".csv", ".db", ".trc", ".log", MF4])
def test_what_python_can_writes(tmp_path, suffix):
    path = tmp_path / f"a{suffix}"
    with can.Logger(path) as writer:
        for message in MESSAGES:
            writer.on_message_received(message)
        writer.on_message_received(can.Message(timestamp=START_S + 1.0, arbitration_id=0x123, is_extended_id=False))
    reader, found = read(path)
    assert found == WANTED
    assert counted(reader) == {ELEVEN_BIT: 1}
    if suffix not in (".db", ".mf4"):
        (tmp_path / "packed").write_bytes(gzip.compress(path.read_bytes()))
        assert read(tmp_path / "packed")[1] == WANTED


def test_a_packed_database_says_what_to_do(tmp_path):
    (tmp_path / "a.db.gz").write_bytes(gzip.compress(b"SQLite format 3\0" + bytes(100)))
    with pytest.raises(UserError, match="unpack it into a file first"):
        read(tmp_path / "a.db.gz")


def test_mf4_needs_a_package_that_is_named(tmp_path, monkeypatch):
    (tmp_path / "a.mf4").write_bytes(b"MDF     4.10    " + bytes(1000))
    monkeypatch.setattr(sys.modules["can.io.mf4"], "asammdf", None)
    with pytest.raises(UserError, match=r"needs the package asammdf: install it with pip install 'goldfield\[mf4\]'"):
        read(tmp_path / "a.mf4")


@pytest.mark.skipif(not HAS_ASAMMDF, reason="asammdf (the extra mf4) is not installed")
@pytest.mark.parametrize("share", [0.2, 0.5, 0.95])
def test_a_torn_mf4_is_refused_in_a_sentence(tmp_path, share):
    """It has its tables at the end; what asammdf says of it in its destructors does not reach the terminal."""
    with can.Logger(tmp_path / "a.mf4") as writer:
        for message in MESSAGES * 50:
            writer.on_message_received(message)
    whole = (tmp_path / "a.mf4").read_bytes()
    (tmp_path / "a.mf4").write_bytes(whole[: int(share * len(whole))])
    words = ["run", "--log", str(tmp_path / "a.mf4"), "--site", str(SITE)]
    done = subprocess.run([sys.executable, "-m", "goldfield", *words], capture_output=True, text=True, check=False)
    assert (done.returncode, done.stdout) == (2, "")
    said = "is damaged or was cut off, and no message can be read: give another log"
    assert done.stderr == f"goldfield: {tmp_path / 'a.mf4'}: {said}\n"


@pytest.mark.parametrize("suffix", [".log", ".asc", ".blf", ".csv", ".db"])
def test_marks_are_messages_in_every_format_that_has_remote_frames(tmp_path, suffix):
    path = tmp_path / f"a{suffix}"
    marks = [mark(None, START_S), mark(100, START_S + 1.0)]
    with can.Logger(str(path)) as logger:
        for message in (marks[0], *MESSAGES[:3], marks[1], *MESSAGES[3:]):
            logger.on_message_received(message)
    reader = CandumpReader(path)
    messages = list(reader)
    assert [(place, reads(m)) for place, m in enumerate(messages) if is_mark(m)] == [(0, False), (4, True)]
    assert [(m.arbitration_id, bytes(m.data)) for m in messages if not is_mark(m)] == WANTED
    assert counted(reader) == {}


def test_a_printed_mark_is_one(tmp_path):
    assert is_mark(parse(b" (0.1)  can0  02000064   [0]  remote request"))
    assert parse(b"(0.1) can0 02001064#R") == REMOTE, "no EPOCH has the index 1"


OTHERS = {
    "(0.1) can0 123#DEADBEEF": ELEVEN_BIT,
    "(0.1) can0 20000004#0001000000000000": ERROR,
    "(0.1) can0 18DAF110#R8": REMOTE,
    "(0.1) can0 18DAF110#R": REMOTE,
    "(0.1) can0 7A1##1" + "00" * 64: FD,
    "(0.1) can0 18DAF110##1" + "00" * 12: FD,
    " (0.1)  can0  123   [4]  DE AD BE EF": ELEVEN_BIT,
    " (0.1)  can0  20000004   [8]  00 01 00 00 00 00 00 00   ERRORFRAME": ERROR,
    " (0.1)  can0  18DAF110   [8]  remote request": REMOTE,
    " (0.1)  can0  18DAF110  [12]  00 01 02 03 04 05 06 07 08 09 0A 0B": FD,
}
TORN = [
    "(0.1) can0 02000064#7C008",
    "(0.1) can0 02000064",
    "(0.1",
    " (0.1)  can0  02000064   [8]  7C 00 80",
    "(0.1) can0 02000064#7C008011E10B0000FF",
    "(9e99) can0 02000064#7C008011E10B0000",
    "(2026-13-45 99:00:00) can0 02000064#7C008011E10B0000",
    "garbage",
    "\x1b]0;title\x07",
    "\x00\x00\x00",
]


@pytest.mark.parametrize("line", OTHERS)
def test_other_traffic_is_no_corruption(tmp_path, capsys, line):
    assert parse(line.encode()) == OTHERS[line]
    (tmp_path / "a.log").write_text(LOGGED + line + "\n" + LOGGED)
    reader, found = read(tmp_path / "a.log")
    assert (found, counted(reader)) == (WANTED * 2, {OTHERS[line]: 1})
    assert capsys.readouterr().err == ""


@pytest.mark.parametrize("line", TORN)
def test_lines_that_cannot_be_read_are_counted_and_told(tmp_path, capsys, line):
    (tmp_path / "a.log").write_text(LOGGED + line + "\n" + line + "\n" + LOGGED)
    reader, found = read(tmp_path / "a.log")
    assert (found, counted(reader)) == (WANTED * 2, {CORRUPT: 2})
    number = len(MESSAGES) + 1
    assert f"a.log: 2 lines could not be read and were left out (first: number {number})\n" in capsys.readouterr().err


@pytest.mark.parametrize("suffix", [".asc", ".blf", ".csv", ".trc"])
def test_a_torn_file_gives_what_came_before(tmp_path, suffix):
    path = tmp_path / f"a{suffix}"
    with can.Logger(path) as writer:
        for message in MESSAGES * 100:
            writer.on_message_received(message)
    path.write_bytes(path.read_bytes()[: path.stat().st_size * 9 // 10])
    _, found = read(path)
    assert len(found) >= (len(MESSAGES) if suffix == ".blf" else len(MESSAGES) * 80)  # BLF packs in blocks
    assert found == (WANTED * 100)[: len(found)]


def test_a_torn_packed_log_is_told(tmp_path, capsys):
    (tmp_path / "a.log.gz").write_bytes(gzip.compress(LOGGED.encode() * 200)[:-500])
    _, found = read(tmp_path / "a.log.gz")
    assert len(found) > len(MESSAGES)
    assert "is damaged or was cut off behind" in capsys.readouterr().err


@pytest.mark.parametrize("suffix", [".csv", ".trc"])
def test_a_bad_line_in_the_middle_costs_that_line(tmp_path, suffix):
    path = tmp_path / f"a{suffix}"
    with can.Logger(path) as writer:
        for message in MESSAGES:
            writer.on_message_received(message)
    lines = path.read_text().splitlines(keepends=True)
    path.write_text(
        "".join(
            [
                *lines[:-10],
                "1,2,zzz\n" if suffix == ".csv" else "   1  1.000 DT  1 02000064 Rx -  8    7C ZZ 80\n",
                *lines[-10:],
            ]
        )
    )
    reader, found = read(path)
    assert found == WANTED
    assert counted(reader) == {CORRUPT: 1}


def test_an_endless_file_is_no_log():
    with pytest.raises(UserError, match=r"^/dev/zero:1: the log holds no message"):
        read("/dev/zero")


HEADERS = {
    "no columns": ";$FILEVERSION=2.0\n",
    "no columns but a start time": ";$FILEVERSION=2.1\n;$STARTTIME=46353.9\n",
    "a start time that is no number": ";$FILEVERSION=2.1\n;$STARTTIME=46|353.9\n",
}


@pytest.mark.parametrize("header", HEADERS.values(), ids=HEADERS)
def test_a_header_that_tells_too_little_ends_the_reading(tmp_path, header):
    """Found by the fuzzer: the reader of .trc failed at the same place again and again, for ever."""
    path = tmp_path / "log.trc"
    path.write_text(header + 20 * "  1  1.000 DT 0064 Rx 1 00\n")
    seen = []
    with path.open("rb") as file, pytest.raises(DAMAGE):
        seen.extend(itertools.islice(frames(str(path), file), 100))
    assert set(seen) == {CORRUPT}
    with pytest.raises(UserError, match="is damaged or was cut off, and no message can be read"):
        list(CandumpReader(path))


@pytest.mark.parametrize("identifier", ["20000064x", "FFFFFFFFFx"])
def test_an_identifier_of_more_than_29_bits_is_corrupt(tmp_path, identifier):
    """Found by the fuzzer: python-can's readers of text do not look, and its lower bits are those of a message."""
    path = tmp_path / "log.asc"
    with can.ASCWriter(path) as writer:
        for number in (0x64, 0x65):
            writer(can.Message(timestamp=START_S, arbitration_id=number, data=b"\x07"))
    assert [message.arbitration_id for message in CandumpReader(path)] == [0x64, 0x65]
    path.write_text(path.read_text().replace("65x", identifier))
    reader = CandumpReader(path)
    assert [message.arbitration_id for message in reader] == [0x64]
    assert counted(reader) == {CORRUPT: 1}
