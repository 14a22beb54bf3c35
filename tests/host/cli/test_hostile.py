"""Hostile command lines: whatever a file, an option or the environment holds, the answer is one sentence.

No case may end in a traceback or in "a defect of goldfield", hang, or be taken without a word. Nearly all run in this
process; the few that need streams or signals of their own are in `test_hostile_streams`.
"""

import itertools
import os
import re
import shutil

import pytest

from goldfield.cli import main
from hil_sim.clib import ROOT
from tests.host.fake_sensor import SITE

EXAMPLES = ROOT / "docs" / "examples"
GOOD_SITE = SITE.read_text()
FIELDS = (EXAMPLES / "fields.csv").read_text().splitlines()
HEADER, ROWS = FIELDS[0], FIELDS[1:9]
SAMPLES = ["chip,bx_T,by_T,bz_T", *(f"{chip},1e-6,1e-6,1e-6" for chip in range(1023))]


@pytest.fixture(scope="module")
def room(tmp_path_factory):
    folder = tmp_path_factory.mktemp("room")
    shutil.copy(SITE, folder / "site.toml")
    shutil.copy(EXAMPLES / "recording.log", folder / "recording.log")
    (folder / "fields.csv").write_text("\n".join(FIELDS[:9]) + "\n")
    (folder / "samples.csv").write_text("\n".join(SAMPLES) + "\n")
    (folder / "folder").mkdir()
    (folder / "empty").write_bytes(b"")
    (folder / "binary").write_bytes(bytes(range(256)) * 40)
    (folder / "zeros").write_bytes(bytes(10_000))
    (folder / "loop").symlink_to("loop")
    (folder / "dangling").symlink_to("nowhere")
    os.mkfifo(folder / "pipe")
    return folder


def outcome(capsys, words):
    try:
        code = main([str(word) for word in words])
    except SystemExit as end:
        code = end.code
    captured = capsys.readouterr()
    for text in (captured.err, captured.out):
        assert "Traceback" not in text
        assert "defect of goldfield" not in text
        assert "failed unexpectedly" not in text
        assert all(c.isprintable() or c == "\n" for c in text)
    return code, captured


def check_refused(capsys, words, codes=(2,)):
    code, captured = outcome(capsys, words)
    assert code in codes, captured.err
    sentence = captured.err.splitlines()[-1]
    assert sentence.startswith("goldfield")
    assert len(sentence) > 20
    assert len(sentence) < 2000
    return captured.err


# Files that are none.

PLACES = ["nowhere", "folder", "empty", "binary", "zeros", "loop", "dangling", "pipe", "site.toml/x", "a\0b", "x" * 300]
PLACES += ["/dev/zero", "/dev/null", "/proc/self/mem", ""]
READERS = {
    "the site of locate": ["locate", "fields.csv", "--site"],
    "the site of separate": ["separate", "samples.csv", "--site"],
    "the site of run": ["run", "--log", "recording.log", "--site"],
    "the site of samples": ["samples", "--port", "/dev/null", "--site"],
    "a table of fields": ["locate", "--site", "site.toml"],
    "a table of samples": ["separate", "--site", "site.toml"],
    "a log": ["run", "--site", "site.toml", "--log"],
    "a body": ["locate", "fields.csv", "--site", "site.toml", "--own-body"],
    "a scenario": ["hil"],
}
NOT_GIVEN = ("a body", "")
"""An empty option is one that is not given."""


@pytest.mark.parametrize(("reader", "place"), [p for p in itertools.product(READERS, PLACES) if p != NOT_GIVEN])
def test_files_that_are_none(room, monkeypatch, capsys, reader, place):
    monkeypatch.chdir(room)
    monkeypatch.setattr("goldfield.files.inputs.PIPE_S", 0.02)
    check_refused(capsys, [*READERS[reader], place])


# Values of a site file.

KEYS = ["chip_period_s", "degree", "noise_T", "position_m", "axis", "turns", "radius_m", "current_A", "code"]
VALUES = ["", '"x"', "true", "nan", "inf", "-inf", "0", "-1", "1e300", "1e-300", "[]", "[1, 2]", "{}", "1979-05-27"]
VALUES += ["9" * 5000, "[[[[]]]]", '"\\u001b[2J"', "1_", "[nan, 0, 0]", "[1e308, 1e308, 1e308]"]
HARMLESS = {("position_m", "0"), ("axis", "[1e308, 1e308, 1e308]"), ("code", "0"), ("current_A", "-1")}


def with_value(key, value):
    lines = GOOD_SITE.splitlines()
    row = next(i for i, line in enumerate(lines) if line.split("=")[0].strip() == key)
    lines[row] = f"{key} = {value}"
    return "\n".join(lines)


@pytest.mark.parametrize(("key", "value"), [pair for pair in itertools.product(KEYS, VALUES) if pair not in HARMLESS])
def test_values_of_a_site_file(tmp_path, capsys, key, value):
    (tmp_path / "site.toml").write_text(with_value(key, value))
    told = check_refused(capsys, ["locate", "--site", tmp_path / "site.toml", "fields.csv"])
    assert "site.toml" in told


UNITS = [
    ("chip_period_s", "97.75", "microseconds, that is 9.775e-05 s"),
    ("noise_T", "2.0", "milligauss, that is 2e-07 T"),
    ("radius_m", "149", "millimetres, that is 0.149 m"),
    ("current_A", "10001", "milliamperes, that is 10.001 A"),
    ("position_m", "[3000.0, 0.0, 0.0]", "millimetres, that is 2.9"),
]
DOUBTS = [
    ("chip_period_s", "0.09775", "unusual; if it is in milliseconds, that is 9.775e-05 s"),
    (
        "radius_m",
        "14.9",
        "unusual; if it is in millimetres, that is 0.0149 m; if it is in centimetres, that is 0.149 m",
    ),
    ("current_A", "500", "unusual; if it is in milliamperes, that is 0.5 A"),
    ("noise_T", "1e-4", "unusual"),
    ("position_m", "[300.0, 0.0, 0.0]", "unusual; if it is in millimetres, that is 0.2"),
]


@pytest.mark.parametrize(("key", "value", "words"), UNITS)
def test_a_number_in_another_unit_is_refused_with_the_unit(tmp_path, capsys, key, value, words):
    (tmp_path / "site.toml").write_text(with_value(key, value))
    assert words in check_refused(capsys, ["locate", "--site", tmp_path / "site.toml", "fields.csv"])


@pytest.mark.parametrize(("key", "value", "words"), DOUBTS)
def test_an_unusual_number_is_told(room, tmp_path, capsys, key, value, words):
    (tmp_path / "site.toml").write_text(with_value(key, value))
    code, captured = outcome(capsys, ["locate", "--site", tmp_path / "site.toml", room / "fields.csv"])
    assert code == 0
    assert words in captured.err


@pytest.mark.parametrize(("unusual", "lines", "rest"), [(3, 3, ""), (4, 3, "1 more value of the site file is")])
def test_many_unusual_numbers_are_told_in_few_lines(room, tmp_path, capsys, unusual, lines, rest):
    begin, *beacons = GOOD_SITE.split("[[beacon]]")
    beacons[:unusual] = [re.sub(r"current_A = .*", "current_A = 500.0", beacon) for beacon in beacons[:unusual]]
    (tmp_path / "site.toml").write_text("[[beacon]]".join([begin, *beacons]))
    code, captured = outcome(capsys, ["locate", "--site", tmp_path / "site.toml", room / "fields.csv"])
    assert code == 0
    assert captured.err.count("which is unusual") == lines
    assert ("more value" in captured.err, rest in captured.err) == (bool(rest), True)


TEXTS = {
    "an unknown key": GOOD_SITE + "\nbaecon = 1\n",
    "a close key": GOOD_SITE.replace("radius_m", "radius", 1),
    "no beacon": GOOD_SITE.split("[[beacon]]")[0],
    "one id twice": GOOD_SITE.replace('"b2"', '"b1"'),
    "an id that acts": GOOD_SITE.replace('"b1"', '"b\\u001b[2J"'),
    "an id with spaces": GOOD_SITE.replace('"b1"', '" b1"'),
    "an id of two lines": GOOD_SITE.replace('"b1"', '"""b\n1"""'),
    "an id that is empty": GOOD_SITE.replace('"b1"', '""'),
    "an id that is a float": GOOD_SITE.replace('"b1"', "1.5"),
    "deep": "x = " + "[" * 5000,
    "a table twice": GOOD_SITE + "\n[site]\n",
    "a lone carriage return": GOOD_SITE.replace("\n", "\r"),
    "UTF-16": GOOD_SITE,
    "a zero byte": GOOD_SITE + "\0",
    "large": "# " + "x" * 5_000_000,
    "YAML": "site:\n  name: room\n",
    "JSON": '{"site": {}}',
    "many points": GOOD_SITE.replace("radius_m = 0.149", f"points_m = [{'[0.0, 0.0, 0.1],' * 100_000}]", 1),
}


@pytest.mark.parametrize("text", TEXTS)
def test_texts_of_a_site_file(tmp_path, capsys, text):
    (tmp_path / "site.toml").write_bytes(TEXTS[text].encode("utf-16" if text == "UTF-16" else "utf-8"))
    check_refused(capsys, ["locate", "--site", tmp_path / "site.toml", "fields.csv"])


GOOD_TEXTS = {
    "CRLF": GOOD_SITE.replace("\n", "\r\n"),
    "a byte order mark": "\ufeff" + GOOD_SITE,
    "line separators in a comment": "# north\u2028hall\u2029of\u0085old\n" + GOOD_SITE,
    "ids that are numbers": GOOD_SITE.replace('"b1"', "1"),
    "letters of elsewhere": GOOD_SITE.replace('"prigge8"', '"Hörsaal 三"'),
}


@pytest.mark.parametrize("text", GOOD_TEXTS)
def test_texts_of_a_site_file_that_are_sound(tmp_path, capsys, text):
    (tmp_path / "site.toml").write_bytes(GOOD_TEXTS[text].encode())
    rows = [row.replace(",b1,", ",1,") if "numbers" in text else row for row in (HEADER, *ROWS)]
    (tmp_path / "fields.csv").write_text("\n".join(rows))
    code, captured = outcome(capsys, ["locate", "--site", tmp_path / "site.toml", tmp_path / "fields.csv"])
    assert code == 0, captured.err
    assert "1 epoch: 1 ok" in captured.out


# Tables.

CELLS = ["", "x", "nan", "inf", "-1", "1e300", "0x10", "1_0", "\x1b[2J", "9" * 200, "1,2", '"', "\u0661", "'"]
COLUMNS = ["epoch", "t_s", "beacon", "bx_T", "sigma_T"]
SOUND_CELLS = {("bx_T", ""), ("bx_T", "nan"), ("sigma_T", ""), ("bx_T", "-1"), ("t_s", "-1"), ("t_s", "1e300")}
SOUND_CELLS |= {("t_s", "1_0"), ("bx_T", "1_0"), ("t_s", "9" * 200), ("t_s", "\u0661"), ("bx_T", "\u0661")}


@pytest.mark.parametrize("cell", CELLS)
@pytest.mark.parametrize("column", COLUMNS)
def test_cells_of_a_table_of_fields(tmp_path, capsys, column, cell):
    cells = ROWS[0].split(",")
    cells[HEADER.split(",").index(column)] = cell
    (tmp_path / "fields.csv").write_text("\n".join([HEADER, ",".join(cells)]))
    words = ["locate", "--site", SITE, tmp_path / "fields.csv"]
    if (column, cell) in SOUND_CELLS:
        assert outcome(capsys, words)[0] == 0
    else:
        assert "fields.csv:2: " in check_refused(capsys, words)


TABLES = {
    "no header": "\n".join(ROWS),
    "a header alone": HEADER,
    "other columns": "a,b\n1,2",
    "a column twice": HEADER + ",t_s\n" + ROWS[0] + ",1",
    "semicolons": "\n".join(FIELDS).replace(",", ";"),
    "tabs": "\n".join(FIELDS).replace(",", "\t"),
    "carriage returns": "\r".join(FIELDS),
    "an open quote": HEADER + '\n"' + "\n".join(ROWS),
    "a long line": HEADER + "\n" + "1" * 200_000,
    "rows out of order": "\n".join([HEADER, ROWS[0], "7,0.7,b1,1e-7,1e-7,1e-7,1e-9", *ROWS[1:]]),
}


@pytest.mark.parametrize("table", TABLES)
def test_texts_of_a_table(tmp_path, capsys, table):
    (tmp_path / "fields.csv").write_bytes(TABLES[table].encode())
    check_refused(capsys, ["locate", "--site", SITE, tmp_path / "fields.csv"])


def test_a_table_in_milligauss_is_told(tmp_path, capsys):
    (tmp_path / "fields.csv").write_text(f"{HEADER}\n1,0.1,b1,1.2,2.0,0.5,1e-9\n")
    _, captured = outcome(capsys, ["locate", "--site", SITE, tmp_path / "fields.csv"])
    assert "fields.csv:2: bx_T is 1.2 T, more than a sensor measures: give tesla (in milligauss" in captured.err
    assert captured.err.count("more than a sensor") == 1


# Options.

NUMBERS = ["", "x", "-1", "0", "nan", "inf", "1e300", "0x1", "1,5", "\x1b[2J", "9" * 5000]
OPTIONS = {
    "--seconds": ["run", "--log", "recording.log", "--site", "site.toml"],
    "--node": ["run", "--log", "recording.log", "--site", "site.toml"],
    "--alert-limit": ["locate", "fields.csv", "--site", "site.toml"],
    "--mains": ["separate", "samples.csv", "--site", "site.toml"],
    "--harmonics": ["separate", "samples.csv", "--site", "site.toml", "--mains", "50"],
    "--cycles": ["samples", "--port", "/dev/null", "--site", "site.toml"],
    "--seed": ["hil", "prigge8"],
    "--pace": ["hil", "prigge8"],
}
SOUND = {("--seed", "0"), ("--pace", "0"), ("--pace", "1e300")}


@pytest.mark.parametrize(("option", "value"), [p for p in itertools.product(OPTIONS, NUMBERS) if p not in SOUND])
def test_numbers_of_options(room, monkeypatch, capsys, option, value):
    monkeypatch.chdir(room)
    told = check_refused(capsys, [*OPTIONS[option], f"{option}={value}"])
    assert option in told


COMMAND_LINES = [
    [],
    ["nonsense"],
    ["\x1b[2J"],
    ["run", "--nonsense"],
    ["run", "extra", "--log", "recording.log", "--site", "site.toml"],
    ["run", "--log", "recording.log"],
    ["run", "--site", "site.toml"],
    ["run", "--log", "recording.log", "--site", "site.toml", "--track", "--on-sensor"],
    ["run", "--log", "recording.log", "--port", "x", "--site", "site.toml"],
    ["run", "--log", "-", "--site", "-"],
    ["run", "--log", "recording.log", "--site", "site.toml", "--record", "-", "--fields", "-"],
    ["run", "--log", "recording.log", "--site", "site.toml", "--record", "recording.log"],
    ["run", "--log", "recording.log", "--site", "site.toml", "--record", "recording.log", "--force"],
    ["run", "--log", "recording.log", "--site", "site.toml", "--record", "fields.csv"],
    ["run", "--log", "recording.log", "--site", "site.toml", "--record", "new.trc"],
    ["run", "--log", "recording.log", "--site", "site.toml", "--fields", "folder"],
    ["run", "--log", "recording.log", "--site", "site.toml", "--fields", "nowhere/f.csv"],
    ["run", "--log", "recording.log", "--site", "site.toml", "--fields", "site.toml", "--force"],
    ["run", "--log", "recording.log", "--site", "site.toml", "--truth", "nowhere"],
    ["run", "--log", "recording.log", "--site", "site.toml", "--truth", "folder"],
    ["run", "--log", "recording.log", "--site", "site.toml", "--truth", "/dev/zero"],
    ["run", "--log", "recording.log", "--site", "site.toml", "--truth", "binary"],
    ["run", "--log", "recording.log", "--site", "-", "--truth", "-"],
    ["run", "--log", "site.toml", "--site", "site.toml"],
    ["run", "--log", "fields.csv", "--site", "site.toml"],
    ["run", "--port", "/dev/null", "--site", "site.toml"],
    ["run", "--port", "site.toml", "--site", "site.toml"],
    ["run", "--port", "nowhere", "--site", "site.toml"],
    ["run", "--can", "x", "--site", "site.toml"],
    ["run", "--can", ":", "--site", "site.toml"],
    ["run", "--can", "nonsense:0", "--site", "site.toml"],
    ["run", "--can", "socketcan:" + "x" * 300, "--site", "site.toml"],
    ["locate"],
    ["locate", "--site", "site.toml"],
    ["locate", "--site", "-", "-"],
    ["locate", "fields.csv", "--site", "fields.csv"],
    ["locate", "samples.csv", "--site", "site.toml"],
    ["separate", "fields.csv", "--site", "site.toml"],
    ["separate", "samples.csv", "--site", "site.toml", "--harmonics", "3"],
    ["separate", "samples.csv", "--site", "site.toml", "--mains", "5115"],
    ["separate", "samples.csv", "--site", "site.toml", "--mains", "3000", "--harmonics", "2"],
    ["separate", "samples.csv", "--site", "site.toml", "--mains", "50", "--harmonics", "100000"],
    ["separate", "samples.csv", "--site", "site.toml", "--fields", "samples.csv", "--force"],
    ["separate", "samples.csv", "--site", "site.toml", "--fields", "fields.csv"],
    ["samples", "--site", "site.toml"],
    ["samples", "--port", "nowhere", "--site", "site.toml"],
    ["samples", "--port", "/dev/null", "--site", "site.toml", "--at", "1", "2"],
    ["samples", "--port", "/dev/null", "--site", "site.toml", "--at", "1", "2", "nan"],
    ["hil"],
    ["hil", "nonsense"],
    ["hil", "site.toml"],
    ["hil", "prigge8", "--boards", "paper"],
    ["hil", "prigge8", "--site", "fields.csv"],
    ["hil", "prigge8", "--truth", "fields.csv"],
    ["hil", "prigge8", "--site", "new", "--truth", "new"],
    ["paper"],
    ["paper", "nonsense"],
    ["paper", "prigge", "--degree", "99"],
    ["paper", "prigge", "--figure", "fields.csv"],
    ["paper", "zheng", "simulate", "fields.csv", "--grid"],
    ["paper", "zheng", "survey", "samples.csv", "--map", "samples.csv"],
    ["paper", "zheng", "locate", "nowhere"],
]


@pytest.mark.parametrize("words", COMMAND_LINES, ids=" ".join)
def test_command_lines(room, monkeypatch, capsys, words):
    monkeypatch.chdir(room)
    before = {path.name: path.read_bytes() for path in room.iterdir() if path.is_file()}
    check_refused(capsys, words)
    assert {path.name: path.read_bytes() for path in room.iterdir() if path.is_file()} == before


# The environment.

SWITCHES = [("", False), ("0", False), ("no", False), ("False", False), ("off", False), ("1", True), ("yes", True)]


@pytest.mark.parametrize(("value", "on"), SWITCHES)
def test_switches_of_the_environment(room, monkeypatch, capsys, value, on):
    monkeypatch.setenv("GOLDFIELD_JSON", value)
    code, captured = outcome(capsys, ["locate", room / "fields.csv", "--site", room / "site.toml"])
    assert (code, captured.out.startswith("{")) == (0, on)


@pytest.mark.parametrize("variable", ["ALERT_LIMIT", "SITE", "OWN_BODY"])
@pytest.mark.parametrize("value", ["nowhere", "-1", "\x1b[2J"])
def test_values_of_the_environment(room, monkeypatch, capsys, variable, value):
    monkeypatch.setenv("GOLDFIELD_SITE", str(room / "site.toml"))
    monkeypatch.setenv(f"GOLDFIELD_{variable}", value)
    check_refused(capsys, ["locate", room / "fields.csv"])
