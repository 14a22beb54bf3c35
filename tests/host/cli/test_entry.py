"""Start-up: only the subcommand that was called is imported, and the list of subcommands tells all of them."""

import fcntl
import json
import os
import re
import signal
import subprocess
import sys
from importlib.metadata import entry_points, version
from pathlib import Path

import pytest

from goldfield import errors
from goldfield.cli import main
from goldfield.cli.entry import COMMANDS, build_parser
from goldfield_protocol import protocol_hash
from hil_sim.clib import ROOT
from tests.host.fake_sensor import SITE, log_of

LIST_MODULES = """
import sys
from goldfield.cli import main
try:
    main(sys.argv[1:])
except SystemExit:
    pass
print(*sys.modules, file=sys.stderr)
"""


def modules_of(*arguments):
    done = subprocess.run(
        [sys.executable, "-c", LIST_MODULES, *arguments], capture_output=True, text=True, check=True, cwd="/"
    )
    return set(done.stderr.split())


@pytest.mark.parametrize("word", ["--version", "--help"])
def test_neither_version_nor_help_imports_a_numerical_package_or_a_subcommand(word):
    modules = modules_of(word)
    assert not modules & {"numpy", "scipy", "cffi", "rich", "shtab", "hil_sim.command"}
    assert not modules & {module for module, _ in COMMANDS.values()}
    # The hash of the protocol, which the version tells, is computed from the table of messages.
    assert bool(modules & {"can", "cantools"}) == (word == "--version")


def test_poses_of_a_usual_site_need_none_of_the_large_packages(tmp_path):
    log = tmp_path / "run.log"
    log.write_text(log_of(range(3)))
    modules = modules_of("run", "--log", str(log), "--site", str(SITE), "-q")
    assert "goldfield.locate.locator" in modules
    assert not modules & {
        "scipy",
        "numpy.f2py",
        "numpy.testing",
        "matplotlib",
        "rich",
        "asammdf",
        "pyarrow",
        "starlette",
    }


def test_the_version_tells_the_protocol(capsys):
    with pytest.raises(SystemExit):
        main(["--version"])
    assert capsys.readouterr().out == f"goldfield {version('goldfield')}, protocol {protocol_hash():#010x}\n"


COMPLETE = """
source /dev/stdin
COMP_WORDS=("$@")
COMP_CWORD=$(($# - 1))
_shtab_goldfield 2>/dev/null
printf '%s\n' "${COMPREPLY[@]}"
"""


@pytest.mark.parametrize(
    ("words", "found"),
    [
        (["mon"], {"monitor"}),
        (["hi"], {"hil"}),
        (["nodes", "ge"], {"get"}),
        (["doctor", "--si"], {"--site"}),
        (["completion", ""], {"bash", "zsh"}),
    ],
)
def test_bash_completes_commands_options_and_choices(words, found, capsys):
    assert main(["completion", "bash"]) == 0
    script = capsys.readouterr().out
    command = ["bash", "-c", COMPLETE, "bash", "goldfield", *words]
    done = subprocess.run(command, input=script, capture_output=True, text=True, check=True)
    assert set(done.stdout.split()) == found


def test_zsh_gets_every_subcommand(capsys):
    assert main(["completion", "zsh"]) == 0
    script = capsys.readouterr().out
    assert script.startswith("#compdef goldfield")
    assert all(f"    {name}:" in script for name in (*COMMANDS, "hil", "paper"))


@pytest.mark.parametrize(
    "words", [["-q", "nodes", "--port", "/dev/nowhere"], ["nodes", "--port", "/dev/nowhere", "-q"]]
)
def test_quiet_leaves_failures(words, capsys):
    assert main(words) == 2
    assert capsys.readouterr().err == "goldfield: /dev/nowhere: there is no such port: check --port\n"
    errors.tell("a note")
    assert capsys.readouterr().err == ""
    errors.tell("a failure", failure=True)
    assert capsys.readouterr().err == "goldfield: a failure\n"


def test_verbose_adds_the_traceback(capsys):
    assert main(["nodes", "--port", "/dev/nowhere", "-v"]) == 2
    assert "Traceback" in capsys.readouterr().err
    assert main(["nodes", "--port", "/dev/nowhere"]) == 2  # the next call is as loud as usual
    assert "Traceback" not in capsys.readouterr().err


def test_the_help_of_run_imports_run_alone():
    modules = modules_of("run", "--help")
    assert "goldfield.cli.run" in modules
    assert not modules & {"scipy.signal", "scipy.stats", "matplotlib", "hil_sim.command", "goldfield.cli.separate"}


@pytest.mark.parametrize("name", [*COMMANDS, "hil", "paper"])
def test_the_help_of_no_command_imports_what_it_works_with(name):
    assert not modules_of(name, "--help") & {"scipy", "matplotlib", "unicorn", "magpylib", "hil_sim.rig", "can"}


def test_separation_needs_no_signal_package(tmp_path):
    modules = modules_of(
        "separate", "--site", str(ROOT / "host" / "sites" / "prigge8.toml"), str(tmp_path / "none.csv")
    )
    assert "goldfield.access.of_site" in modules
    assert "scipy.signal" not in modules


def test_the_help_lists_every_subcommand_with_a_line(capsys):
    with pytest.raises(SystemExit):
        main(["--help"])
    lines = dict(line.split(maxsplit=1) for line in capsys.readouterr().out.splitlines() if line.startswith("    "))
    for name, (_, summary) in COMMANDS.items():
        assert lines[name] == summary
    for entry_point in entry_points(group="goldfield.commands"):
        assert lines[entry_point.name]
    assert lines["hil"] == "simulated bench: boards, coils, field and links"


@pytest.mark.parametrize("name", COMMANDS)
def test_each_subcommand_of_the_table_is_there(name, capsys):
    with pytest.raises(SystemExit) as stopped:
        main([name, "--help"])
    assert stopped.value.code == 0
    assert capsys.readouterr().out.startswith(f"usage: goldfield {name} ")


def test_a_foreign_command_must_have_the_name_of_its_entry_point(capsys, monkeypatch):
    class Entry:
        name, value = "here", "package:command"

        def load(self):
            return lambda subparsers: subparsers.add_parser("elsewhere")

    monkeypatch.setattr("importlib.metadata.entry_points", lambda group: [Entry()])
    assert main(["here"]) == 3
    assert "it adds no subcommand of this name" in capsys.readouterr().err
    assert "(cannot be loaded)" in build_parser().format_help()


ROOM = str(ROOT / "docs" / "examples" / "room.toml")
FIELDS = str(ROOT / "docs" / "examples" / "fields.csv")
LOG = str(ROOT / "docs" / "examples" / "recording.log")
HANGS_S = 300.0
"""What takes so long does not end."""
BUFFERED = {name: value for name, value in os.environ.items() if name != "PYTHONUNBUFFERED"}
COMMAND_LINES = [
    ["--version"],
    ["--help"],
    ["locate", "--site", ROOM, FIELDS],
    ["run", "--site", ROOM, "--log", LOG, "--seconds", ".3"],
    ["run", "--site", ROOM, "--log", LOG, "--seconds", ".3", "--json"],
]


def ended(words, **streams):
    command = [sys.executable, "-m", "goldfield", *words]
    return subprocess.run(command, env=BUFFERED, check=False, text=True, **streams)


@pytest.mark.parametrize("words", COMMAND_LINES)
def test_a_full_output_is_told_in_a_sentence(words):
    with Path("/dev/full").open("w") as full:
        done = ended(words, stdout=full, stderr=subprocess.PIPE)
    last = done.stderr.splitlines()[-1]
    assert done.returncode == 3
    assert last == (
        "goldfield: the output cannot be written: No space left on device: make room, or write to another place"
    )
    assert "Traceback" not in done.stderr
    assert "Exception ignored" not in done.stderr


@pytest.mark.parametrize("words", COMMAND_LINES)
def test_a_reader_that_went_away_is_no_error(words):
    reading, writing = os.pipe()
    os.close(reading)
    done = ended(words, stdout=writing, stderr=subprocess.PIPE)
    os.close(writing)
    assert done.returncode == 0
    assert "ignored" not in done.stderr
    assert "Traceback" not in done.stderr


def test_errors_that_nobody_can_be_told_keep_their_exit_code():
    with Path("/dev/full").open("w") as full:
        assert ended(["locate", "--site", ROOM, "nowhere.csv"], stdout=subprocess.PIPE, stderr=full).returncode == 2
        assert ended(["locate"], stdout=full, stderr=full).returncode == 2


def test_a_run_whose_reader_sleeps_ends_at_the_first_interrupt(tmp_path):
    reading, writing = os.pipe()
    fcntl.fcntl(writing, fcntl.F_SETPIPE_SZ, 4096)  # of the 40 kB that the run prints
    again = tmp_path / "again.log"
    os.mkfifo(again)
    words = ["run", "--site", ROOM, "--log", LOG, "--json", "--record", str(again)]
    with subprocess.Popen(
        [sys.executable, "-m", "goldfield", *words], env=BUFFERED, stdout=writing, stderr=subprocess.PIPE, text=True
    ) as running:
        os.close(writing)
        with again.open("rb") as recorded:
            # The pipe that nobody reads does not hold up the recording.
            whole = Path(LOG).stat().st_size
            assert len(recorded.read(whole)) == whole
            running.send_signal(signal.SIGINT)
            _, err = running.communicate()
    os.close(reading)
    assert running.returncode == 0
    assert re.match(r"\d+ epochs: \d+ ok", err)
    assert re.search(r"\d+ epochs were left out of the lines on stdout", err)


INTERRUPTED = """
import sys
from goldfield.cli import main
from goldfield.sensor.sinks import Branch, Fanout
from tests.host.interrupted import interrupted_after

with interrupted_after(int(sys.argv.pop(1)), Fanout.__exit__, Fanout.close, Fanout._close, Branch.close):
    code = main(sys.argv[1:])
sys.exit(code)
"""
"""The program, interrupted when it has run so many lines of what closes its sinks, the last of which waits for them."""


@pytest.mark.parametrize("lines", [0, 4, 8])
def test_a_run_whose_reader_sleeps_ends_wherever_the_interrupt_comes(lines):
    reading, writing = os.pipe()
    fcntl.fcntl(writing, fcntl.F_SETPIPE_SZ, 4096)
    command = [sys.executable, "-c", INTERRUPTED, str(lines), "run", "--site", ROOM, "--log", LOG, "--json"]
    done = subprocess.run(
        command, env=BUFFERED, stdout=writing, stderr=subprocess.PIPE, text=True, timeout=HANGS_S, cwd=ROOT
    )
    os.close(writing)
    os.close(reading)
    assert done.returncode == 0
    assert re.search(r"\d+ epochs were left out of the lines on stdout", done.stderr)


def test_without_stderr_nothing_but_json_goes_to_stdout():
    words = ["run", "--site", ROOM, "--log", LOG, "--seconds", ".3", "--json"]
    closing = ["sh", "-c", 'exec "$@" 2>&-', "sh", sys.executable, "-m", "goldfield", *words]
    done = subprocess.run(closing, env=BUFFERED, check=False, text=True, stdout=subprocess.PIPE)
    assert done.returncode == 0
    assert [json.loads(line)["status"] for line in done.stdout.splitlines()] == ["ok"] * 3


def test_a_can_channel_that_cannot_be_opened_is_one_line():
    done = ended(["run", "--site", ROOM, "--can", "udp_multicast:192.0.2.1"], stderr=subprocess.PIPE)
    assert done.returncode == 2
    assert re.fullmatch(r"goldfield: --can udp_multicast:192\.0\.2\.1: cannot be opened: .*\n", done.stderr)


@pytest.mark.parametrize("command", ["doctor", "nodes", "hil"])
def test_an_option_that_a_command_does_not_have_points_to_the_help_of_that_command(command, capsys):
    with pytest.raises(SystemExit) as end:
        main([command, "--nope", *["prigge8"] * (command == "hil")])
    assert end.value.code == 2
    assert capsys.readouterr().err == f"goldfield: unrecognized arguments: --nope; see goldfield {command} --help\n"


@pytest.mark.parametrize(
    ("name", "words"),
    [("elftools", "a package is missing"), ("goldfield.nowhere", "a defect"), ("hil_sim.nowhere", "a defect")],
)
def test_only_packages_of_others_are_to_be_installed(capsys, monkeypatch, name, words):
    def fails(_):
        raise ModuleNotFoundError(f"No module named '{name}'", name=name)

    monkeypatch.setattr("goldfield.cli.locate.run", fails)
    assert main(["locate", "fields.csv"]) == 3
    assert words in capsys.readouterr().err
