"""Outputs are whole or not there, overwrite only by force, and lose nothing that was written when they are cut."""

import errno
import os
import random
import signal
import sys
import threading

import numpy as np
import pytest

from goldfield import Fields, load_site, read_fields
from goldfield.errors import SystemFailure, UserError
from goldfield.files import durable, outputs
from goldfield.files.outputs import OutputFile, check_outputs, write_file
from goldfield.link.recordings import CandumpReader, CandumpWriter
from goldfield.link.traffic import CORRUPT
from goldfield.sensor.fields_table import FieldsWriter
from tests.host.fake_sensor import SITE
from tests.host.link.test_log_formats import MESSAGES


def test_a_table_is_there_whole_or_not_at_all(tmp_path):
    path = tmp_path / "a.csv"
    with OutputFile(path, "the table") as file:
        file.write(b"half")
        assert not path.exists()
    assert path.read_bytes() == b"half"
    file = OutputFile(path, "the table", force=True)
    file.write(b"other")
    file.discard()
    assert path.read_bytes() == b"half"
    assert [entry.name for entry in tmp_path.iterdir()] == ["a.csv"]


def test_a_live_file_grows_in_its_place_and_replaces_another_with_its_first_record(tmp_path):
    path, old = tmp_path / "new.log", tmp_path / "old.log"
    old.write_bytes(b"a day of work")
    with OutputFile(path, "the recording", live=True) as file:
        assert path.read_bytes() == b""
        file.write(b"one\n")
        assert path.read_bytes() == b"one\n"
    with pytest.raises(UserError, match=r"old\.log: exists and is not empty: .*--force"):
        OutputFile(old, "the recording", live=True)
    forced = OutputFile(old, "the recording", live=True, force=True)
    assert old.read_bytes() == b"a day of work"
    forced.write(b"one\n")
    assert old.read_bytes() == b"one\n"
    forced.close()
    OutputFile(old, "the recording", live=True, force=True).close()  # without a record nothing is replaced
    assert old.read_bytes() == b"one\n"
    assert sorted(entry.name for entry in tmp_path.iterdir()) == ["new.log", "old.log"]


def test_two_programs_do_not_record_into_one_file(tmp_path):
    with OutputFile(tmp_path / "a.log", "the recording", live=True) as first:
        with pytest.raises(UserError, match="another program is recording into it"):
            OutputFile(tmp_path / "a.log", "the recording", live=True)
        first.write(b"x")


def test_a_file_that_another_program_made_meanwhile_is_not_replaced(tmp_path):
    file = OutputFile(tmp_path / "a.csv", "the table")
    file.write(b"mine")
    (tmp_path / "a.csv").write_bytes(b"theirs")
    with pytest.raises(UserError, match="exists and is not empty"):
        file.close()
    assert (tmp_path / "a.csv").read_bytes() == b"theirs"


def test_a_link_stays_one_and_the_mode_is_kept(tmp_path):
    real, link = tmp_path / "real.csv", tmp_path / "link.csv"
    real.write_bytes(b"old")
    real.chmod(0o640)
    link.symlink_to(real)
    write_file(link, b"new", "the table", force=True)
    assert (link.is_symlink(), real.read_bytes(), real.stat().st_mode & 0o777) == (True, b"new", 0o640)


BAD_PLACES = ["nowhere/a.csv", ".", "a\0b", "loop"]


@pytest.mark.parametrize("live", [False, True])
@pytest.mark.parametrize("place", BAD_PLACES)
def test_places_that_cannot_be_written(tmp_path, monkeypatch, place, live):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "loop").symlink_to("loop")
    with pytest.raises(UserError, match="the table cannot be written"):
        OutputFile(place, "the table", live=live)


def test_a_full_device_is_a_failure_and_not_bad_usage():
    with pytest.raises(SystemFailure, match=r"^/dev/full: the table cannot be written: No space left on device$"):
        write_file("/dev/full", b"x", "the table")


def test_a_pipe_that_nobody_reads_is_not_waited_for_without_end(tmp_path, monkeypatch):
    monkeypatch.setattr("goldfield.files.inputs.PIPE_S", 0.05)
    os.mkfifo(tmp_path / "pipe")
    with pytest.raises(UserError, match="is a pipe that nobody reads"):
        OutputFile(tmp_path / "pipe", "the table")


def test_what_is_printed_beside_a_file_on_stdout_goes_to_stderr(capfdbinary):
    with OutputFile("-", "the table") as file:
        print("told")
        file.write(b"1,2\n")
    print("after")
    captured = capfdbinary.readouterr()
    assert captured.out == b"1,2\nafter\n"
    assert captured.err == b"told\n"


@pytest.mark.parametrize(
    ("outputs", "inputs", "words"),
    [
        ({"--a": "-", "--b": "-"}, {}, "--a and --b are both stdout"),
        ({}, {"--a": "-", "--b": "-"}, "--a and --b are both stdin"),
        ({"--a": "x", "--b": "./x"}, {}, "x: is the file of --a and would be overwritten by --b"),
        ({"--a": "full"}, {}, "full: exists and is not empty: give a new file for --a, or --force"),
        ({"--a": "hard"}, {"--b": "full"}, "hard: is the file of --b and would be overwritten by --a"),
        ({"--a": "dangling"}, {"--b": "x"}, "dangling: is the file of --b and would be overwritten by --a"),
    ],
)
def test_clashes(tmp_path, monkeypatch, outputs, inputs, words):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "full").write_bytes(b"x")
    (tmp_path / "hard").hardlink_to("full")
    (tmp_path / "dangling").symlink_to("x")
    with pytest.raises(UserError, match=words):
        check_outputs(outputs, inputs)


@pytest.mark.parametrize(("number", "stream"), [(1, "stdout"), (2, "stderr")])
def test_a_redirected_stream_is_an_output_too(tmp_path, number, stream):
    path = tmp_path / "fields.csv"
    path.write_bytes(b"x")
    before = os.dup(number)
    with path.open("ab") as file:
        os.dup2(file.fileno(), number)
    try:
        with pytest.raises(UserError, match=rf"is the file of FIELDS\.csv, and {stream} goes into it"):
            check_outputs({}, {"FIELDS.csv": path})
        with pytest.raises(UserError, match=rf"is the file of --record, and {stream} goes into it"):
            check_outputs({"--record": path}, {}, force=True)
    finally:
        os.dup2(before, number)
        os.close(before)


def record_without_end(path, progress):
    """Record as a live run does, and tell after each message which it was; it is killed."""
    writer = CandumpWriter(path)
    for place in range(10**9):
        message = MESSAGES[place % len(MESSAGES)]
        message.timestamp = 0.001 * place
        writer.write(message)
        os.write(progress, b"%010d" % place)


def test_a_recording_that_is_killed_at_any_moment_opens_and_has_all_messages(tmp_path):
    """kill -9 at 50 random moments after the first message: at most the message that was being written is missing."""
    moments = random.Random(10)
    for place in range(50):
        path = tmp_path / f"{place}.log"
        reading, writing = os.pipe()
        if (child := os.fork()) == 0:
            try:
                record_without_end(path, writing)
            finally:
                os._exit(1)
        os.close(writing)
        told = b""
        for _ in range(moments.randrange(1, 500)):  # the child is somewhere behind what it has told of
            told = os.read(reading, 10)
        os.kill(child, signal.SIGKILL)
        os.waitpid(child, 0)
        while more := os.read(reading, 1 << 20):
            told = (told + more)[-10:]
        os.close(reading)
        reader = CandumpReader(path)
        kept = list(reader)
        assert reader.traffic[CORRUPT] <= 1
        assert len(kept) >= int(told) + 1
        assert kept[-1].timestamp >= 0.001 * int(told) - 1e-6


def fields(epoch, time_s):
    return Fields(epoch, time_s, ("b1", "b2", "b3"), np.full((3, 3), 1e-7), np.full(3, 1e-9))


GROUPS = {
    "a restart": [(5, 0.5), (6, 0.6), (0, 0.01), (5, 0.5), (6, 0.6)],
    "a wrap": [(2**20 - 1, 1e5), (0, 1e5 + 0.1), (1, 1e5 + 0.2)],
    "the same recording twice": [(5, 0.5), (6, 0.6)] * 2,
    "a restart at the same number": [(5, 0.5), (5, 0.4)],
    "time that goes back": [(5, 0.5), (4, 0.4), (3, 0.3)],
}


@pytest.mark.parametrize("name", GROUPS)
def test_a_table_that_was_written_is_read(tmp_path, name):
    site = load_site(SITE)
    with FieldsWriter(tmp_path / "f.csv") as writer:
        for epoch, time_s in GROUPS[name]:
            writer.write(fields(epoch, time_s))
    assert [(f.epoch, f.time_s) for f in read_fields(site, tmp_path / "f.csv")] == GROUPS[name]


def test_an_endless_sigma_is_left_out_of_the_table(tmp_path):
    with FieldsWriter(tmp_path / "f.csv") as writer:
        writer.write(Fields(1, 0.1, ("b1", "b2"), np.full((2, 3), 1e-7), np.array([np.inf, 1e-9])))
    (epoch,) = read_fields(load_site(SITE), tmp_path / "f.csv")
    assert epoch.beacons == ("b2",)


def test_a_live_file_is_handed_to_the_disk_without_holding_the_writer_up(tmp_path, monkeypatch):
    """Every `SYNC_S` while something is written; a disk that takes for ever holds only the sync itself up."""
    monkeypatch.setattr(durable, "SYNC_S", 0.001)
    begun, go_on, sizes = threading.Event(), threading.Event(), []

    def fdatasync(descriptor):
        sizes.append(os.fstat(descriptor).st_size)
        begun.set()
        assert go_on.wait(30.0)

    monkeypatch.setattr(os, "fdatasync", fdatasync)
    with OutputFile(tmp_path / "a.log", "the recording", live=True) as file:
        file.write(b"one\n")
        assert begun.wait(30.0)
        file.write(b"two\n")  # while the disk is at work
        assert (tmp_path / "a.log").read_bytes() == b"one\ntwo\n"
        go_on.set()
    assert (sizes[0], sizes[-1]) == (4, 8), "the rest follows at the end at the latest"


def test_nothing_is_synced_while_nothing_is_written(tmp_path, monkeypatch):
    looks = threading.Semaphore(0)

    class Stop(threading.Event):
        def wait(self, timeout=None):
            looks.release()
            return super().wait(0.001)

    syncs = []
    monkeypatch.setattr(durable.threading, "Event", Stop)
    monkeypatch.setattr(os, "fdatasync", syncs.append)
    file = OutputFile(tmp_path / "a.log", "the recording", live=True)
    file.write(b"one\n")
    for _ in range(20):
        looks.acquire()
    file.close()
    assert len(syncs) == 1


@pytest.mark.parametrize("at", ["the next record", "the end"])
def test_a_disk_that_fails_to_keep_what_it_took_is_told(tmp_path, monkeypatch, capsys, at):
    failed = threading.Event()

    def fdatasync(_):
        failed.set()
        raise OSError(errno.EIO, os.strerror(errno.EIO))

    monkeypatch.setattr(durable, "SYNC_S", 0.001 if at == "the next record" else 1000.0)
    monkeypatch.setattr(os, "fdatasync", fdatasync)
    writer = CandumpWriter(tmp_path / "a.log")
    writer.write(MESSAGES[0])
    if at == "the next record":
        assert failed.wait(30.0)
        while not writer.failed:  # the thread has yet to keep the error
            writer.write(MESSAGES[1])
    writer.close()
    assert writer.failed
    assert "Input/output error" in capsys.readouterr().err


def test_a_file_system_without_sync_is_written_all_the_same(tmp_path, monkeypatch):
    def fdatasync(_):
        raise OSError(errno.EINVAL, os.strerror(errno.EINVAL))

    monkeypatch.setattr(os, "fdatasync", fdatasync)
    with OutputFile(tmp_path / "a.log", "the recording", live=True) as file:
        file.write(b"one\n")
    assert (tmp_path / "a.log").read_bytes() == b"one\n"


def at_step(step, end):
    """Return a tracer that ends the program in its own way at a line of what writes files, counted from one."""
    left = [step]

    def trace(frame, event, _):
        if frame.f_code.co_filename != outputs.__file__:
            return None
        if event == "line":
            left[0] -= 1
            if left[0] == 0:
                end()
        return trace

    return trace, left


def killed_at(step, path, text, end):
    """Write a file in a process that ends at a step; return whether that step was reached."""
    if (child := os.fork()) == 0:
        try:
            trace, left = at_step(step, end)
            sys.settrace(trace)
            write_file(path, text, "the new site file", force=True)
            os._exit(0 if left[0] > 0 else 1)
        finally:
            os._exit(2)
    return os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]) != 0


def interrupted():
    raise KeyboardInterrupt


@pytest.mark.parametrize("way", ["SIGKILL", "SIGINT"])
def test_a_file_that_is_replaced_is_the_old_or_the_new_wherever_the_program_ends(tmp_path, way):
    """As `goldfield survey --force` replaces a site file: at each line on the way, by kill -9 and by Ctrl-C."""
    end = interrupted if way == "SIGINT" else lambda: os.kill(os.getpid(), signal.SIGKILL)
    old, new = b"# old\n" * 1000, b"# the new site\n" * 3000
    seen, step = [], 0
    while True:
        step += 1
        place = tmp_path / str(step)
        place.mkdir()
        path = place / "room.toml"
        path.write_bytes(old)
        path.chmod(0o640)
        reached = killed_at(step, path, new, end)
        seen.append({old: "old", new: "new"}[path.read_bytes()])
        assert path.stat().st_mode & 0o777 == 0o640
        assert all(one.name.startswith(".room.toml.") for one in place.iterdir() if one != path)
        write_file(path, b"next", "the new site file", force=True)  # what was left lying about is in nobody's way
        assert path.read_bytes() == b"next"
        if not reached:
            break
    assert seen == sorted(seen, reverse=True), "once it is new it stays so"
    assert seen.count("old") > 20
    assert seen.count("new") > 2
