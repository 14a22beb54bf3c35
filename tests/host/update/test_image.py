"""``goldfield image``: what is built is signed into update files, and files that hold something else are refused."""

from __future__ import annotations

import json
import struct

import jsonschema
import pytest

from goldfield.cli import main
from goldfield.update.image_files import read
from goldfield_protocol.image import SLOTS, parse
from goldfield_protocol.messages import protocol_hash
from hil_sim.clib import ROOT
from tests.firmware.boards.stm32f405.boot_flash import slot_bytes

BUILT = ROOT / "build/firmware"
A, B = BUILT / "sensor.elf", BUILT / "slot_b/sensor.elf"


@pytest.fixture
def key(tmp_path, capsys):
    path = tmp_path / "site.key"
    assert main(["keys", "make", str(path)]) == 0
    return path, capsys.readouterr().out.strip()


@pytest.fixture
def update_file(tmp_path, key, capsys):
    path = tmp_path / "sensor.gfi"
    assert main(["image", "sign", str(A), str(B), "--key", str(key[0]), "--out", str(path)]) == 0
    told = capsys.readouterr()
    assert told.err == ""
    assert told.out.endswith("2 images signed, sensor 0.1.0 for slot A, sensor 0.1.0 for slot B\n")
    return path


def test_a_signed_file_holds_what_was_built(update_file, key, capsys):
    for image, elf, slot in zip(read(str(update_file)), (A, B), (0, 1), strict=True):
        built = slot_bytes(elf, slot)
        header, code = parse(built)
        assert (image.header, image.header.address) == (header, SLOTS[slot])
        assert image.data[128:132] == built[128:132]
        assert image.data[448 : 512 + header.length] == built[448 : 512 + header.length]
        assert set(image.data[:64]) == {0xFF}
        assert image.data[512 : 512 + len(code)] == code
    assert main(["image", "show", str(update_file), "--public", key[1]]) == 0
    assert capsys.readouterr().out.count("signed by this key") == 2
    assert main(["image", "show", str(update_file), "--json"]) == 0
    lines = [json.loads(line) for line in capsys.readouterr().out.splitlines()]
    assert [line["slot"] for line in lines] == ["A", "B"]
    for line in lines:
        jsonschema.validate(line, json.loads((ROOT / "docs/schema/image.schema.json").read_text()))
    assert {line["protocol"] for line in lines} == {f"{protocol_hash():#010x}"}
    assert {(line["signed"], line["by_this_key"]) for line in lines} == {(True, None)}


def test_another_key_and_none_are_told(update_file, capsys):
    assert main(["image", "show", str(update_file), "--public", "ab" * 32]) == 2
    told = capsys.readouterr()
    assert told.out.count("signed, and not by this key") == 2
    assert "2 images not signed by this key" in told.err
    assert main(["image", "show", str(A)]) == 0
    assert capsys.readouterr().out.endswith(", not signed\n")
    assert main(["image", "show", str(update_file), "--public", "abc"]) == 2
    assert "'abc' is no public key" in capsys.readouterr().err


def test_one_slot_alone_is_signed_with_a_notice(tmp_path, key, capsys):
    path = tmp_path / "half.gfi"
    assert main(["image", "sign", str(A), "--key", str(key[0]), "--out", str(path)]) == 0
    assert "no sensor that runs slot A can take it" in capsys.readouterr().err
    assert main(["image", "sign", str(A), "--key", str(key[0]), "--out", str(path)]) == 2
    assert "exists and is not empty" in capsys.readouterr().err
    assert main(["image", "sign", str(path), str(B), "--key", str(key[0]), "--out", str(path), "--force"]) == 2
    assert "would be overwritten" in capsys.readouterr().err


def test_two_of_one_slot_are_refused(tmp_path, key, capsys):
    path = tmp_path / "twice.gfi"
    assert main(["image", "sign", str(A), str(A), "--key", str(key[0]), "--out", str(path)]) == 2
    assert "two images are given of the sensor for slot A" in capsys.readouterr().err
    assert not path.exists()


def changed(data, offset, value):
    return data[:offset] + bytes([value]) + data[offset + 1 :]


@pytest.mark.parametrize(
    ("make", "sentence"),
    [
        (lambda _: b"", "is empty"),
        (lambda _: b"hello", "it is shorter than an image's header"),
        (lambda _: bytes(4096), "it has no image's header"),
        (lambda data: data[:-1000], "bytes of code, and there are"),
        (lambda data: data[:600], "bytes of code, and there are"),
        (lambda data: data + b"more", "it is shorter than an image's header"),
        (lambda data: changed(data, 5000, data[5000] ^ 1), "its CRC is wrong: bits of it have changed"),
        (lambda data: changed(data, 448, 0), "it has no image's header"),
        (lambda data: data * 12, "is larger than 3145728 bytes"),
        (lambda _: A.read_bytes()[:40], "it is cut off"),
        (lambda _: A.read_bytes()[:60_000], "holds no image for a board"),
        (lambda _: (ROOT / "build/boot/boot.elf").read_bytes(), "none of it lies in a slot"),
        (lambda _: b"\x7fELF\x02\x01" + bytes(100), "an ELF file of another kind of machine"),
        (lambda _: b"\x7fELF\x01\x01" + b"\xff" * 200, "it is cut off"),
        (lambda _: hostile_segments(), "none of it lies in a slot"),
    ],
    ids=[
        "empty", "text", "zeros", "truncated", "head only", "more behind", "a bit", "magic", "huge", "ELF head",
        "ELF truncated", "boot loader", "64 bits", "ELF ones", "ELF segments",
    ],
)  # fmt: skip
@pytest.mark.parametrize("command", ["show", "flash"])
def test_what_is_no_image_is_refused(update_file, tmp_path, capsys, make, sentence, command):
    path = tmp_path / "hostile.gfi"
    path.write_bytes(make(update_file.read_bytes()))
    words = ["image", "show", str(path)] if command == "show" else ["flash", str(path), "--all", "--port", "/dev/none"]
    assert main(words) == 2
    told = capsys.readouterr()
    assert told.out == ""
    assert told.err.startswith(f"goldfield: {path}: ")
    assert sentence in told.err
    assert told.err.count("\n") == 1


def hostile_segments():
    """Return an ELF file of a great many segments that lie where no slot is."""
    head = bytearray(b"\x7fELF\x01\x01" + bytes(46))
    struct.pack_into("<I", head, 28, 52)
    struct.pack_into("<HH", head, 42, 32, 60_000)
    return bytes(head) + struct.pack("<8I", 1, 0, 0, 0xFFFFFFF0, 0xFFFFFFFF, 0, 0, 0) * 60_000


def test_a_directory_and_nothing_are_refused(tmp_path, capsys):
    assert main(["image", "show", str(tmp_path)]) == 2
    assert "is a directory, not a file of images" in capsys.readouterr().err
    assert main(["flash", str(tmp_path / "gone"), "--all", "--port", "/dev/none"]) == 2
    assert "there is no such" in capsys.readouterr().err
