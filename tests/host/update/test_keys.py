"""The key pair of a site: a file for its owner alone, never overwritten, there whole or not at all."""

from __future__ import annotations

import errno
import json
import os
import re
import stat

import jsonschema
import pytest
from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey
from cryptography.hazmat.primitives.asymmetric.x25519 import X25519PrivateKey
from cryptography.hazmat.primitives.serialization import Encoding, NoEncryption, PrivateFormat

from goldfield.cli import main
from hil_sim.clib import ROOT


def pem(key):
    return key.private_bytes(Encoding.PEM, PrivateFormat.PKCS8, NoEncryption())


def test_a_key_is_made_for_its_owner_alone_and_shown(tmp_path, capsys):
    path = tmp_path / "site.key"
    before = os.umask(0)
    try:
        assert main(["keys", "make", str(path)]) == 0
    finally:
        os.umask(before)
    public = capsys.readouterr().out
    assert re.fullmatch("[0-9a-f]{64}\n", public)
    assert stat.S_IMODE(path.stat().st_mode) == 0o600
    assert list(tmp_path.iterdir()) == [path]
    assert main(["keys", "show", str(path)]) == 0
    assert capsys.readouterr().out == public
    assert main(["keys", "show", str(path), "--json"]) == 0
    line = json.loads(capsys.readouterr().out)
    jsonschema.validate(line, json.loads((ROOT / "docs/schema/key.schema.json").read_text()))
    assert line["public_key"] + "\n" == public


def test_two_keys_are_two(tmp_path, capsys):
    for name in "ab":
        main(["keys", "make", str(tmp_path / name)])
    first, second = capsys.readouterr().out.splitlines()
    assert first != second


def test_a_key_is_never_overwritten(tmp_path, capsys):
    path = tmp_path / "site.key"
    path.write_text("")
    assert main(["keys", "make", str(path)]) == 2
    assert "exists, and a key is never overwritten" in capsys.readouterr().err
    assert path.read_text() == ""
    assert list(tmp_path.iterdir()) == [path]


@pytest.mark.parametrize("mode", [0o640, 0o604, 0o620, 0o602, 0o610, 0o601])
def test_a_key_that_others_may_use_is_refused(tmp_path, capsys, mode):
    path = tmp_path / "site.key"
    main(["keys", "make", str(path)])
    path.chmod(mode)
    assert main(["keys", "show", str(path)]) == 2
    assert f"others may read or write this private key: chmod 600 {path}" in capsys.readouterr().err
    path.chmod(0o400)
    assert main(["keys", "show", str(path)]) == 0


def test_a_passphrase_is_needed_once_it_was_given(tmp_path, capsys, monkeypatch):
    path = tmp_path / "site.key"
    monkeypatch.setenv("GOLDFIELD_PASSPHRASE", "north wall")
    assert main(["keys", "make", str(path), "--passphrase"]) == 0
    public = capsys.readouterr().out
    assert b"ENCRYPTED" in path.read_bytes()
    assert main(["keys", "show", str(path)]) == 0
    assert capsys.readouterr().out == public
    monkeypatch.setenv("GOLDFIELD_PASSPHRASE", "south wall")
    assert main(["keys", "show", str(path)]) == 2
    assert "the passphrase is wrong" in capsys.readouterr().err
    monkeypatch.delenv("GOLDFIELD_PASSPHRASE")
    assert main(["keys", "show", str(path)]) == 2
    assert "no terminal to ask for it: set GOLDFIELD_PASSPHRASE" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("data", "sentence"),
    [
        (b"", "holds no private key"),
        (b"hello", "holds no private key"),
        (pem(Ed25519PrivateKey.generate())[:60], "holds no private key"),
        (pem(X25519PrivateKey.generate()), "holds a key of another kind than Ed25519"),
        (b"x" * 5000, "is larger than 4096 bytes"),
    ],
    ids=["empty", "text", "cut off", "another kind", "huge"],
)
def test_what_is_no_key_is_refused(tmp_path, capsys, data, sentence):
    path = tmp_path / "site.key"
    path.write_bytes(data)
    path.chmod(0o600)
    assert main(["keys", "show", str(path)]) == 2
    assert sentence in capsys.readouterr().err


def test_places_where_no_key_can_be_are_refused(tmp_path, capsys):
    assert main(["keys", "make", str(tmp_path / "no" / "site.key")]) == 2
    assert main(["keys", "show", str(tmp_path)]) == 2
    assert main(["keys", "show", str(tmp_path / "gone")]) == 2
    told = capsys.readouterr().err
    assert "cannot be written: No such file or directory" in told
    assert "is a directory" in told
    assert "there is no such private key" in told


@pytest.mark.parametrize("call", ["fsync", "link"])
def test_a_full_disk_leaves_nothing(tmp_path, capsys, monkeypatch, call):
    def full(*_):
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr(os, call, full)
    path = tmp_path / "site.key"
    assert main(["keys", "make", str(path)]) == 3
    assert f"{path}: the private key cannot be written: No space left on device" in capsys.readouterr().err
    assert list(tmp_path.iterdir()) == []
