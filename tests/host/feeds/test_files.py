"""Trajectories in TUM's format, as numpy reads them, and sentences in the form of NMEA 0183, in files and datagrams."""

import math
import re
import socket
import subprocess
import sys

import numpy as np
import pytest

from goldfield.errors import SystemFailure, UserError
from goldfield.feeds.address import parse_address
from goldfield.feeds.nmea import LETTERS, sentences
from goldfield.feeds.opening import open_feed, open_feeds
from goldfield.types import Status
from hil_sim.clib import ROOT
from tests.host.feeds.made import (
    ATTITUDE,
    ATTITUDE_COV_RAD2,
    POSITION_COV_M2,
    POSITION_M,
    UNIX_S,
    epoch,
    failed,
    pose,
    setting,
    stamped,
)


def opened(url, **changes):
    return open_feed(parse_address(url), setting(**changes))


def written(path, scheme, *items):
    feed = opened(f"{scheme}:{path}")
    for item in items:
        feed.write(item)
    feed.close()
    return path.read_bytes().decode()


def test_a_trajectory_is_read_back_with_its_times(tmp_path):
    path = tmp_path / "walk.txt"
    items = [stamped(unix_s=UNIX_S + 0.1 * number) for number in range(3)]
    assert written(path, "tum", *items).startswith("# unix_s x_m")
    table = np.loadtxt(path)
    assert table.shape == (3, 8)
    assert np.allclose(table[:, 0], UNIX_S + 0.1 * np.arange(3), rtol=0.0, atol=1e-6)
    assert np.allclose(table[:, 1:4], POSITION_M, rtol=0.0, atol=1e-6)
    assert np.allclose(table[:, 4:], ATTITUDE.as_quat(canonical=True), rtol=0.0, atol=1e-9)


def test_a_trajectory_holds_usable_poses_only(tmp_path):
    unusable = [stamped(pose(status=Status.AMBIGUOUS)), stamped(failed()), stamped(unix_s=math.nan)]
    assert written(tmp_path / "a.txt", "tum", *unusable) == ""
    assert len(written(tmp_path / "b.txt", "tum", *unusable, stamped()).splitlines()) == 2


def test_a_file_that_holds_something_is_kept(tmp_path):
    path = tmp_path / "walk.txt"
    path.write_text("dear\n")
    for scheme in ("tum", "nmea"):
        with pytest.raises(UserError, match="exists and is not empty"):
            opened(f"{scheme}:{path}")
        opened(f"{scheme}:{path}", force=True).close()
    assert path.read_text() == "dear\n"


def test_a_full_disk_fails_the_feed_alone(capsys):
    with open_feeds([parse_address("tum:/dev/full")], setting(), live=True) as feeds:
        for number in range(3):
            feeds.write(epoch(number, arrived_s=UNIX_S + number))
    assert feeds.failed
    said = (
        "goldfield: tum:/dev/full: the trajectory cannot be written: No space left on device; the run goes on without\n"
    )
    assert capsys.readouterr().err == said
    with pytest.raises(SystemFailure):
        opened("tum:/dev/full").write(stamped())


FILL = """
import resource, signal, sys
from goldfield.feeds.address import parse_address
from goldfield.feeds.opening import open_feeds
from tests.host.feeds.made import UNIX_S, epoch, setting
signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
before = resource.getrlimit(resource.RLIMIT_FSIZE)
resource.setrlimit(resource.RLIMIT_FSIZE, (5000, before[1]))
with open_feeds([parse_address(url) for url in sys.argv[1:]], setting(), live=False) as feeds:
    for number in range(200):
        feeds.write(epoch(number, arrived_s=UNIX_S + 0.1 * number))
print(feeds.failed)
resource.setrlimit(resource.RLIMIT_FSIZE, before)  # What measures coverage writes a file at the end.
"""


def test_a_disk_that_becomes_full_leaves_whole_lines(tmp_path):
    paths = [tmp_path / "walk.txt", tmp_path / "walk.nmea"]
    words = [sys.executable, "-c", FILL, f"tum:{paths[0]}", f"nmea:{paths[1]}"]
    assert subprocess.run(words, cwd=ROOT, capture_output=True, text=True, check=True).stdout == "True\n"
    for path in paths:
        assert 4800 < path.stat().st_size <= 5000
    assert np.loadtxt(paths[0]).shape[1] == 8
    text = paths[1].read_bytes().decode()
    assert text.endswith("\r\n")
    assert len(fields_of(text)) % 2 == 0


def fields_of(text):
    """Split sentences, with the checksum computed as the standard words it."""
    found = []
    for line in text.split("\r\n")[:-1]:
        body, checksum = re.fullmatch(r"\$([^*$]*)\*([0-9A-F]{2})", line).groups()
        value = 0
        for character in body:
            value ^= ord(character)
        assert value == int(checksum, 16)
        assert len(line) + 2 <= 82
        found.append(body.split(","))
    return found


def test_sentences_hold_place_attitude_deviations_and_latency(tmp_path):
    position, attitude = fields_of(written(tmp_path / "walk.nmea", "nmea", stamped()))
    assert position[0] == "PGFDP"
    assert position[8:] == ["A", "0.062"]
    assert np.allclose(np.array(position[1:5], float), [UNIX_S, *POSITION_M], rtol=0.0, atol=6e-4)
    assert np.allclose(np.array(position[5:8], float), np.sqrt(np.diag(POSITION_COV_M2)), rtol=0.0, atol=6e-4)
    assert attitude[0] == "PGFDA"
    assert attitude[1] == position[1]
    assert np.allclose(np.array(attitude[2:6], float), ATTITUDE.as_quat(canonical=True), rtol=0.0, atol=6e-5)
    assert np.allclose(np.array(attitude[6:9], float), np.sqrt(np.diag(ATTITUDE_COV_RAD2)), rtol=0.0, atol=6e-5)
    assert attitude[9:] == ["A"]


def test_what_is_not_known_is_empty():
    position, attitude = fields_of(sentences(stamped(failed(), unix_s=math.nan), UNIX_S).decode())
    assert position == ["PGFDP", *[""] * 7, "V", ""]
    assert attitude == ["PGFDA", *[""] * 8, "V"]


def test_each_status_has_a_letter_of_its_own():
    assert set(LETTERS) == set(Status)
    assert len(set(LETTERS.values())) == len(Status)


def test_the_longest_sentences_fit():
    """82 characters are the most that NMEA 0183 allows; `fields_of` counts them."""
    worst = pose(
        position_m=np.full(3, -999.9994),
        orientation_xyzw=np.full(4, -0.5),
        position_cov_m2=np.full((3, 3), 9.9994**2),
        attitude_cov_rad2=np.full((3, 3), 3.14159**2),
    )
    assert len(fields_of(sentences(stamped(worst, unix_s=9_999_999_999.25), 9_999_999_999.25 + 9.9994).decode())) == 2


@pytest.fixture
def receiver():
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as listening:
        listening.bind(("127.0.0.1", 0))
        listening.settimeout(60.0)
        yield listening


def test_datagrams_are_lines_of_json(receiver):
    feed = opened(f"udp://127.0.0.1:{receiver.getsockname()[1]}")
    feed.write(stamped())
    data = receiver.recv(65536)
    feed.close()
    assert data.decode() == f"{stamped().json(UNIX_S + 0.0625)}\n"
    assert feed.dropped == 0


def test_datagrams_of_sentences(receiver):
    feed = opened(f"nmea+udp://127.0.0.1:{receiver.getsockname()[1]}")
    feed.write(stamped())
    data = receiver.recv(65536)
    feed.close()
    assert data == sentences(stamped(), UNIX_S + 0.0625)


def test_nobody_listening_is_no_error(receiver):
    port = receiver.getsockname()[1]
    receiver.close()
    feed = opened(f"udp://127.0.0.1:{port}")
    for _ in range(3):
        feed.write(stamped())
    assert feed.dropped == 0
    feed.close()


LONG = "x" * 70_000
"""No datagram is so long."""


def test_what_hinders_a_datagram_is_counted_and_told_once_in_a_row(receiver, capsys):
    url = f"udp://127.0.0.1:{receiver.getsockname()[1]}"
    feed = opened(url)
    for reason in (LONG, LONG, None, LONG):
        feed.write(stamped(pose(reason=reason)))
    assert feed.dropped == 3
    assert (
        capsys.readouterr().err
        == 2 * f"goldfield: {url}: a pose is not sent: Message too long; the next ones are tried\n"
    )
    feed.close()


def test_a_queue_that_is_full_is_counted_alone(receiver, capsys):
    feed = opened(f"udp://127.0.0.1:{receiver.getsockname()[1]}")
    feed._socket = FullSocket()
    feed.write(stamped())
    assert (feed.dropped, capsys.readouterr().err) == (1, "")


class FullSocket:
    """A socket whose queue has no room."""

    def sendto(self, data, place):
        raise BlockingIOError(11, "Resource temporarily unavailable")


def test_datagrams_go_to_an_address_of_ipv6():
    with socket.socket(socket.AF_INET6, socket.SOCK_DGRAM) as listening:
        listening.bind(("::1", 0))
        listening.settimeout(60.0)
        feed = opened(f"udp://[::1]:{listening.getsockname()[1]}")
        feed.write(stamped())
        assert listening.recv(65536).decode() == f"{stamped().json(UNIX_S + 0.0625)}\n"
        feed.close()


def test_a_host_that_nobody_knows_is_refused():
    with pytest.raises(UserError, match=r"^feed=udp://no\.such\.host\.invalid:9: the host is not known"):
        opened("udp://no.such.host.invalid:9")
