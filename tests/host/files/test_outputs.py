"""No command writes over a file that it reads, or writes two things into one file."""

import shutil
from pathlib import Path

import pytest

from goldfield.cli import main
from goldfield.errors import UserError
from goldfield.files.outputs import check_outputs
from hil_sim.clib import ROOT

EXAMPLES = ROOT / "docs" / "examples"


@pytest.fixture
def folder(tmp_path, monkeypatch):
    for name in ("room.toml", "recording.log", "fields.csv"):
        shutil.copy(EXAMPLES / name, tmp_path)
    monkeypatch.chdir(tmp_path)
    return tmp_path


RUN = ["run", "--site", "room.toml", "--log", "recording.log"]
CLASHES = [
    ([*RUN, "--fields", "recording.log"], "recording.log", "--log", "--fields"),
    ([*RUN, "--fields", "./room.toml"], "room.toml", "--site", "--fields"),
    ([*RUN, "--fields", "new", "--record", "new"], "new", "--record", "--fields"),
    (
        ["separate", "--site", "room.toml", "fields.csv", "--fields", "fields.csv"],
        "fields.csv",
        "SAMPLES.csv",
        "--fields",
    ),
    (["hil", "room.toml", "--site", "room.toml"], "room.toml", "SCENARIO", "--site"),
]


@pytest.mark.parametrize(("words", "file", "reads", "writes"), CLASHES)
def test_an_output_that_is_an_input_is_refused_and_nothing_is_lost(
    folder, capsys, monkeypatch, words, file, reads, writes
):
    monkeypatch.setattr("hil_sim.links.serve.load_scenario", lambda name, seed: None)
    before = {path.name: path.read_bytes() for path in folder.iterdir()}
    assert main(words) == 2
    sentence = f"{file}: is the file of {reads} and would be overwritten by {writes}: give another\n"
    assert capsys.readouterr().err == f"goldfield: {sentence}"
    assert {path.name: path.read_bytes() for path in folder.iterdir()} == before


def test_a_link_is_the_file_that_it_points_at(folder):
    Path("link").symlink_to("room.toml")
    with pytest.raises(UserError, match=r"^link: is the file of --site"):
        check_outputs({"--fields": "link"}, {"--site": "room.toml"})


def test_devices_and_options_that_are_not_given_do_not_clash():
    check_outputs({"--record": "/dev/null", "--fields": "/dev/null", "--truth": None, "--other": ""}, {"--site": ""})
