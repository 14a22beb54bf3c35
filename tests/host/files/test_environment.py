"""The words that turn a switch of the environment off, and the switches of the command line."""

from __future__ import annotations

import argparse

import pytest

from goldfield.cli import entry, location_options, options
from goldfield.files.environment import switched_on
from goldfield.sensor import guard

OFF = ["", " ", "0", "no", "No", "NO", "false", "False", "off", "OFF", " off\n"]
ON = ["1", "yes", "true", "on", "2", "00", "none of these"]
CASES = [(word, False) for word in OFF] + [(word, True) for word in ON]


@pytest.mark.parametrize(("word", "on"), CASES)
def test_words(monkeypatch, word, on):
    monkeypatch.setenv("GOLDFIELD_SWITCH", word)
    assert switched_on("GOLDFIELD_SWITCH") is on


def test_a_switch_that_is_not_set_is_off(monkeypatch):
    monkeypatch.delenv("GOLDFIELD_SWITCH", raising=False)
    assert not switched_on("GOLDFIELD_SWITCH")


@pytest.mark.parametrize("word", ["off", "yes"])
@pytest.mark.parametrize(
    ("add", "option"),
    [(options.add_json, "json"), (location_options.add_track, "track"), (location_options.add_on_sensor, "on_sensor")],
)
def test_every_switch_of_the_command_line_understands_them(monkeypatch, add, option, word):
    monkeypatch.setenv(f"GOLDFIELD_{option.upper()}", word)
    parser = argparse.ArgumentParser()
    add(parser)
    assert getattr(parser.parse_args([]), option) is (word == "yes")


@pytest.mark.parametrize(("word", "shown"), [("false", False), ("on", True)])
def test_tracebacks_understand_them(monkeypatch, capsys, word, shown):
    monkeypatch.setenv("GOLDFIELD_DEBUG", word)

    def defect(_):
        raise ZeroDivisionError

    class Fields:
        epoch, t_s, beacons = 1, 0.0, ()

    monkeypatch.setattr(guard.Pose, "failed", lambda *_, **__: None)
    guard.guarded(defect, Fields())
    assert ("Traceback" in capsys.readouterr().err) is shown
    monkeypatch.setattr(entry, "build_parser", defect)
    assert entry.main(["run"]) == 3
    assert ("Traceback" in capsys.readouterr().err) is shown
