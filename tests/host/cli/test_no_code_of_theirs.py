"""Files of strangers that hold code: whatever reads them, under whatever ending, none of it runs.

Each payload makes a file if it is unpickled, evaluated, built from its tags, or run; that it would is tested, too.
"""

from __future__ import annotations

import contextlib
import gzip
import io
import json
import os
import pickle
import shutil
import sqlite3
import sys

import numpy as np
import pytest
from mcap.writer import Writer

from goldfield.cli import main
from hil_sim.clib import ROOT
from tests.host.fake_sensor import SITE

EXAMPLES = ROOT / "docs/examples"
BOX = ["--box", *"000111", "--step", "1"]
READERS = {
    "a site": ["locate", "fields.csv", "--site"],
    "a scenario": ["hil"],
    "fields": ["locate", "--site", "site.toml"],
    "samples": ["separate", "--site", "site.toml"],
    "a log": ["run", "--json", "--site", "site.toml", "--log"],
    "a recording": ["compare-runs"],
    "a recording to export": ["export", "--to", "npz", "--out", "out.npz", "--force"],
    "a recording to plot": ["plot", "--out", "out.png", "--force"],
    "a body": ["locate", "fields.csv", "--site", "site.toml", "--own-body"],
    "fields of a walk": ["survey", "--free", "position", "--site", "site.toml", "--out", "new.toml", "--force"],
    "known points": ["survey", "fields.csv", "--site", "site.toml", "--out", "new.toml", "--force", "--known"],
    "a lattice": ["plan", *BOX, "--lattice"],
    "a task of planning": ["plan", "--site", "site.toml", *BOX, "--optimise"],
    "a floor": [
        "plan",
        "--site",
        "site.toml",
        *BOX,
        "--out",
        "o.html",
        "--force",
        "--floor-extent",
        *"0011",
        "--floor",
    ],
    "images": ["image", "show"],
    "a public key": ["keys", "show"],
}
ENDINGS = (".toml", ".csv", ".log", ".mcap", ".npz", ".db", ".log.gz", ".blf", ".asc", ".trc", ".mf4", ".json", ".png")


class Bomb:
    """Runs a command when it is unpickled."""

    def __init__(self, command):
        self.command = command

    def __reduce__(self):
        return os.system, (self.command,)


def python_of(marker):
    """Return an expression of Python that makes the file."""
    return f"__import__('pathlib').Path({str(marker)!r}).touch()"


def npz_of(marker):
    file = io.BytesIO()
    np.savez(file, position_m=np.array([Bomb(f"touch {marker}")], dtype=object), allow_pickle=True)
    return file.getvalue()


def database_of(marker, folder):
    """Return a log of python-can in SQLite whose data are pickles, and whose rows a view of expressions makes."""
    path = folder / "made.sqlite"
    path.unlink(missing_ok=True)
    with sqlite3.connect(path) as file:
        file.execute(
            "CREATE TABLE kept (ts REAL, id INTEGER, x INTEGER, r INTEGER, e INTEGER, dlc INTEGER, data PICKLE)"
        )
        file.execute("INSERT INTO kept VALUES (0, 1, 1, 0, 0, 8, ?)", (pickle.dumps(Bomb(f"touch {marker}")),))
        file.execute(
            "CREATE VIEW messages AS SELECT ts, id AS arbitration_id, x AS extended, r AS remote, e AS error, dlc, data"
            " FROM kept"
        )
    file.close()
    return path.read_bytes()


def mcap_of(marker):
    """Return an MCAP file with what our reader looks for, each as code: schemas, messages, metadata, attachments."""
    file, code = io.BytesIO(), pickle.dumps(Bomb(f"touch {marker}"))
    writer = Writer(file)
    writer.start(profile=python_of(marker), library="os.system")
    for topic in ("/goldfield/line", "/goldfield/can", "/can0", python_of(marker)):
        schema = writer.register_schema(name="os.system", encoding="python", data=python_of(marker).encode())
        channel = writer.register_channel(topic=topic, message_encoding="pickle", schema_id=schema)
        writer.add_message(channel, log_time=1, publish_time=1, data=code)
    words = json.dumps({"py/reduce": [{"py/function": "os.system"}, {"py/tuple": [f"touch {marker}"]}]})
    writer.add_metadata("goldfield", {"site": python_of(marker), "options": words, "version": "__reduce__"})
    for name in ("site.toml", "site.py", "setup.py"):
        writer.add_attachment(1, 1, name, "application/python-pickle", code)
    writer.finish()
    return file.getvalue()


def payloads(marker, folder):
    """Return name and bytes of each payload."""
    python, code = python_of(marker), pickle.dumps(Bomb(f"touch {marker}"))
    tags = f"!!python/object/apply:os.system ['touch {marker}']\n"
    header, *rows = (EXAMPLES / "fields.csv").read_text().splitlines()
    cells = "\n".join([header, *rows[:7], ",".join([python] * len(header.split(",")))])
    return {
        "pickle": code,
        "packed pickle": gzip.compress(code),
        "arrays of objects": npz_of(marker),
        "tags of YAML": tags.encode(),
        "Python": python.encode(),
        "a shell": f"#!/bin/sh\ntouch {marker}\n".encode(),
        "cells": cells.encode(),
        "names": SITE.read_text().replace("name =", f"name = {json.dumps(python)} #", 1).encode(),
        "values": f"name = {json.dumps(python)}\nchip_period_s = {json.dumps(python)}\n[python]\nx = 1\n".encode(),
        "JSON": json.dumps({"position_m": python, "py/object": "os.system", "epoch": [python]}).encode(),
        "a database": database_of(marker, folder),
        "MCAP": mcap_of(marker),
    }


@pytest.fixture
def room(tmp_path, monkeypatch):
    """A folder to work in that is a stranger's, too: modules by the names of what is imported, and entry points."""
    marker = tmp_path / "marker"
    folder = tmp_path / "room"
    info = folder / "evil-1.0.dist-info"
    info.mkdir(parents=True)
    (info / "METADATA").write_text("Metadata-Version: 2.1\nName: evil\nVersion: 1.0\n")
    groups = ("goldfield.commands", "can.interface", "can.io.message_reader")
    (info / "entry_points.txt").write_text("".join(f"[{group}]\nevil = evil:run\n" for group in groups))
    for name in ("evil", "asammdf", "sitecustomize", "conftest", "site", "distributed", "setup"):
        (folder / f"{name}.py").write_text(python_of(marker))
    shutil.copy(SITE, folder / "site.toml")
    shutil.copy(EXAMPLES / "fields.csv", folder / "fields.csv")
    monkeypatch.chdir(folder)
    return folder, marker


@pytest.mark.parametrize("reader", READERS)
def test_no_code_of_a_file_runs(room, capsys, reader):
    (folder, marker), seen = room, 0
    for name, data in payloads(marker, folder).items():
        for ending in ENDINGS:
            path = folder / f"theirs{ending}"
            path.write_bytes(gzip.compress(data) if ending.endswith(".gz") else data)
            path.chmod(0o755)
            with contextlib.suppress(SystemExit):
                main([*READERS[reader], str(path)])
            told = capsys.readouterr().err
            seen += path.name in told
            assert "Traceback" not in told, (name, ending)
            assert not marker.exists(), (name, ending)
    assert seen > len(ENDINGS)  # it was read, and told to be none


@pytest.mark.parametrize(
    ("name", "run"),
    [
        ("pickle", pickle.loads),
        ("packed pickle", lambda data: pickle.loads(gzip.decompress(data))),
        ("arrays of objects", lambda data: np.load(io.BytesIO(data), allow_pickle=True)["position_m"]),
        ("tags of YAML", lambda data: pytest.importorskip("yaml").unsafe_load(data)),
        ("Python", lambda data: exec(data)),
        ("a shell", lambda data: os.system(data.decode().splitlines()[1])),
    ],
)
def test_a_reader_that_ran_it_would_be_seen(room, name, run):
    folder, marker = room
    run(payloads(marker, folder)[name])
    assert marker.exists()


def test_modules_and_entry_points_beside_the_files_would_be_seen(room, monkeypatch):
    folder, marker = room
    monkeypatch.syspath_prepend(str(folder))
    __import__("evil")
    sys.modules.pop("evil")
    assert marker.exists()
