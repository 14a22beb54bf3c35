"""The file of a key, and the answers that are computed with it."""

from __future__ import annotations

import hashlib
import json
import os
import stat
from pathlib import Path

import can
import pytest

from goldfield.errors import UserError
from goldfield.link.access import holds_key
from goldfield.link.access_key import AccessKey, load_key, make_key
from goldfield.link.requests import set_request
from goldfield.recording.about import About
from goldfield.sensor.options import Options
from goldfield.sensor.receiver import Receiver
from goldfield.site import load
from goldfield_protocol.parameters import PARAMETERS, Kind
from hil_sim.clib import ROOT

VECTORS = json.loads((ROOT / "protocol/vectors/access.json").read_text())["answers"]


@pytest.mark.parametrize("vector", VECTORS, ids=lambda one: one["name"])
def test_answers_are_those_of_the_vectors(vector: dict[str, str]) -> None:
    """And the vectors are HMAC by its definition (RFC 2104), of the SHA-512 of hashlib."""
    key, unique_id, number, answer = (bytes.fromhex(vector[n]) for n in ("key", "unique_id", "number", "answer"))
    inner, outer = (bytes(byte ^ pad for byte in key.ljust(128, b"\0")) for pad in (0x36, 0x5C))
    message = b"goldfield access 1" + unique_id + number
    assert hashlib.sha512(outer + hashlib.sha512(inner + message).digest()).digest()[:8] == answer
    told = AccessKey(key, "").answer(int.from_bytes(number, "little"), unique_id)
    assert told == int.from_bytes(answer, "little")


def test_a_new_key_is_its_owners_alone_and_each_is_another(tmp_path: Path) -> None:
    before = os.umask(0)
    try:
        made = [make_key(tmp_path / name) for name in ("a", "b")]
    finally:
        os.umask(before)
    assert [stat.S_IMODE((tmp_path / name).stat().st_mode) for name in ("a", "b")] == [0o600, 0o600]
    assert [load_key(tmp_path / name).raw for name in ("a", "b")] == [key.raw for key in made]
    assert len({key.raw for key in made}) == 2
    assert sorted(path.name for path in tmp_path.iterdir()) == ["a", "b"]
    assert made[0].raw.hex() not in repr(made[0])


@pytest.mark.parametrize("there", ["file", "link", "broken link"])
def test_a_key_overwrites_nothing(tmp_path: Path, there: str) -> None:
    place = tmp_path / "site.key"
    if there == "file":
        place.write_text("precious")
    else:
        place.symlink_to(tmp_path / "other")
    if there == "link":
        (tmp_path / "other").write_text("precious")
    before = sorted(path.name for path in tmp_path.iterdir())
    with pytest.raises(UserError, match="never overwritten"):
        make_key(place)
    assert sorted(path.name for path in tmp_path.iterdir()) == before
    assert there == "broken link" or place.read_text() == "precious"


def test_a_place_that_cannot_be_written_is_told(tmp_path: Path) -> None:
    with pytest.raises(UserError, match="the key cannot be written"):
        make_key(tmp_path / "nowhere" / "site.key")


@pytest.mark.parametrize("mode", [0o640, 0o604, 0o620, 0o601])
def test_a_key_that_others_may_use_is_refused(tmp_path: Path, mode: int) -> None:
    place = tmp_path / "site.key"
    make_key(place)
    load_key(place)
    place.chmod(mode)
    with pytest.raises(UserError, match="chmod 600 "):
        load_key(place)


@pytest.mark.parametrize("content", [b"", b"00", 32 * b"0", 33 * b"1", 31 * b"1", 32 * b"g", 32 * b"\xff", b"\n" * 99])
def test_what_is_no_key_is_refused(tmp_path: Path, content: bytes) -> None:
    place = tmp_path / "site.key"
    place.write_bytes(content)
    place.chmod(0o600)
    with pytest.raises(UserError, match="holds no key"):
        load_key(place)


def test_a_key_that_is_not_there_is_told(tmp_path: Path) -> None:
    with pytest.raises(UserError, match="there is no such key"):
        load_key(tmp_path / "site.key")


class Messages:
    """A source of a few messages, and a recorder."""

    traffic: dict[str, int] = {}  # noqa: RUF012 - nothing is counted

    def __init__(self, messages: list[can.Message]) -> None:
        self.messages, self.recorded = messages, list[can.Message]()

    def receive(self, timeout_s: float) -> can.Message | None:
        return self.messages.pop(0) if self.messages else None

    def write(self, message: can.Message) -> None:
        self.recorded.append(message)

    def close(self) -> None:
        pass


def test_a_key_that_somebody_sets_on_the_bus_is_not_recorded() -> None:
    first = PARAMETERS["access_key"].first
    requests = [set_request(7, identifier, 12345, Kind.UNSIGNED) for identifier in range(first - 1, first + 5)]
    messages = [can.Message(arbitration_id=one, data=data) for one, data in requests]
    source = Messages(list(messages))
    receiver = Receiver(source, "bus", source)
    while receiver.receive_raw(0.0) is not None:
        pass
    assert [one.arbitration_id for one in source.recorded] == [requests[0][0], requests[5][0]]
    assert [holds_key(one) for one, _ in requests] == [False, True, True, True, True, False]


def test_a_recording_tells_nothing_of_a_key(tmp_path: Path) -> None:
    key = make_key(tmp_path / "site.key")
    site = ROOT / "docs/examples/room.toml"
    about = About("can", Options(key=key, node=7), load(site), str(site), True)
    assert about.metadata(None) == About("can", Options(node=7), load(site), str(site), True).metadata(None)
    assert key.raw.hex() not in repr(about)
