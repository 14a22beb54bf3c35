"""Names with the time of the start: a service that starts again and again keeps every recording."""

from pathlib import Path

import pytest

from goldfield.cli import main
from goldfield.files.dated import DatedNames
from tests.host.fake_sensor import SITE, log_of

START_S = 1_700_000_000.0
STAMP = "20231114T221320Z"


def test_each_start_has_names_of_its_own_in_the_order_of_time():
    names = [DatedNames(START_S + later_s).of("a-{time}.mcap") for later_s in (0.0, 1.0, 3600.0, 86400.0, 4e7)]
    assert names == sorted(set(names))
    assert DatedNames(START_S).of_url("tum:/var/lib/{time}.txt") == f"tum:/var/lib/{STAMP}.txt"
    assert DatedNames(START_S).of_url("ws:") == "ws:"


def test_what_got_nothing_is_taken_away_and_all_else_stays(tmp_path):
    with DatedNames(START_S) as names:
        empty, filled = names.of(str(tmp_path / "{time}.a")), names.of_url(f"tum:{tmp_path}/{{time}}.b")
        other = names.of(str(tmp_path / "empty"))
        for path in (empty, other):
            Path(path).touch()
        (tmp_path / f"{STAMP}.b").write_text("x")
        names.of(str(tmp_path / "{time}.never"))
    assert filled == f"tum:{tmp_path}/{STAMP}.b"
    assert sorted(path.name for path in tmp_path.iterdir()) == [f"{STAMP}.b", "empty"]


def test_a_run_that_starts_again_keeps_the_recordings_before(tmp_path, monkeypatch):
    log, places = tmp_path / "a.log", tmp_path / "kept"
    log.write_text(log_of(range(3)))
    places.mkdir()
    names = [f"{places}/{{time}}{end}" for end in (".mcap", ".csv", ".json", ".txt", ".nmea")]
    words = ["run", "--log", str(log), "--site", str(SITE), "--record", names[0], "--fields", names[1]]
    words += ["--summary", names[2], "--feed", f"tum:{names[3]}", "--feed", f"nmea:{names[4]}"]
    for later_s in (0.0, 3.0):
        monkeypatch.setattr("time.time", lambda later_s=later_s: START_S + later_s)
        assert main(words) == 0
    assert len(list(places.iterdir())) == 10
    assert all(path.stat().st_size for path in places.iterdir())


@pytest.mark.parametrize("command", ["run", "view"])
def test_a_port_that_is_not_there_leaves_no_empty_files(tmp_path, capsys, command):
    kept = ["--record", f"{tmp_path}/{{time}}.mcap"] if command == "run" else ["--bind", "127.0.0.1:0"]
    words = ["--port", f"{tmp_path}/none", "--site", str(SITE), "--feed", f"tum:{tmp_path}/{{time}}.txt"]
    assert main([command, *words, *kept]) == 2
    assert "there is no such port" in capsys.readouterr().err
    assert not list(tmp_path.iterdir())
