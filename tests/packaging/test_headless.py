"""The files for a machine without a screen: units that systemd takes, a rule of udev, and options that exist."""

import re
import shlex
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from goldfield.cli.entry import build_parser
from hil_sim.clib import ROOT

HEADLESS = ROOT / "host" / "packaging" / "headless"
UNITS = sorted(HEADLESS.glob("*.service"))
MOST_EXPOSED = 2.5
"""Level of `systemd-analyze security`, from 0 to 10: below it a service is called well protected."""
PLACES = {"/opt/goldfield/bin": str(Path(sys.executable).parent)}
RULE = re.compile(
    r'(ACTION|SUBSYSTEM|DRIVER|KERNEL|TAG|ENV\{[A-Z_]+\}|ATTR\{[a-z_/]+\}|SYMLINK|GOTO|LABEL)(==|!=|\+=|=)"([^"]*)"'
)
needs_systemd = pytest.mark.skipif(shutil.which("systemd-analyze") is None, reason="systemd is not installed")


def settings(path):
    """Return the lines of a unit or of an environment file that set something, as pairs."""
    lines = [line for line in path.read_text().splitlines() if "=" in line and not line.startswith("#")]
    return [tuple(line.split("=", 1)) for line in lines]


@pytest.fixture
def unit(tmp_path, request):
    text = request.param.read_text()
    for place, there in PLACES.items():
        text = text.replace(place, there)
    path = tmp_path / request.param.name
    path.write_text(text)
    return path


def test_there_is_a_unit_for_poses_and_one_for_the_page():
    assert [path.name for path in UNITS] == ["goldfield-run.service", "goldfield-view.service"]


@needs_systemd
@pytest.mark.parametrize("unit", UNITS, indirect=True, ids=lambda path: path.name)
def test_systemd_has_nothing_to_complain_of(unit):
    done = subprocess.run(["systemd-analyze", "verify", str(unit)], capture_output=True, text=True)
    assert (done.returncode, done.stderr) == (0, "")
    done = subprocess.run(
        ["systemd-analyze", "security", "--offline=true", f"--threshold={round(10 * MOST_EXPOSED)}", str(unit)],
        capture_output=True,
        text=True,
    )
    assert done.returncode == 0, done.stdout


@needs_systemd
@pytest.mark.parametrize("unit", UNITS[:1], indirect=True, ids=lambda path: path.name)
def test_a_unit_with_a_slip_is_complained_of(unit):
    unit.write_text(unit.read_text().replace("ProtectHome=yes", "ProtectHouse=yes"))
    done = subprocess.run(["systemd-analyze", "verify", str(unit)], capture_output=True, text=True)
    assert "ProtectHouse" in done.stderr


@pytest.mark.parametrize("path", UNITS, ids=lambda path: path.name)
def test_the_command_of_a_unit_is_one_that_goldfield_takes(path):
    values = dict(settings(HEADLESS / "goldfield.conf"))
    (start,) = [value for name, value in settings(path) if name == "ExecStart"]
    program, *words = [part for word in start.split() for part in shlex.split(values.get(word.lstrip("$"), word))]
    assert program == "/opt/goldfield/bin/goldfield"
    arguments = build_parser(words[0]).parse_args(words)
    assert callable(arguments.run)


def test_what_the_configuration_sets_is_what_options_and_units_read():
    known = {"GOLDFIELD_PORT", "GOLDFIELD_SITE"}
    known |= {
        word.lstrip("$") for path in UNITS for _, value in settings(path) for word in value.split() if "$" in word
    }
    assert {name for name, _ in settings(HEADLESS / "goldfield.conf")} == known


def test_every_line_of_the_rule_is_one_that_udev_knows_and_its_names_are_stable():
    text = (HEADLESS / "99-goldfield.rules").read_text()
    lines = [line for line in text.splitlines() if line and not line.startswith("#")]
    labels = [value for line in lines for name, _, value in RULE.findall(line) if name == "LABEL"]
    for line in lines:
        assert ", ".join(f'{name}{how}"{value}"' for name, how, value in RULE.findall(line)) == line
        for name, _, value in RULE.findall(line):
            assert name != "GOTO" or value in labels
    links = [value for line in lines for name, how, value in RULE.findall(line) if (name, how) == ("SYMLINK", "+=")]
    assert links == ["goldfield", "goldfield-$env{ID_SERIAL_SHORT}", "goldfield-$env{ID_PATH_TAG}"]
    assert dict(settings(HEADLESS / "goldfield.conf"))["GOLDFIELD_PORT"] == f"/dev/{links[0]}"
