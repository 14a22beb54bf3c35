"""`goldfield locate` and `goldfield separate`: shapes of their output, and a sentence for each bad table."""

import json
import subprocess
import sys

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from goldfield.cli import main
from goldfield.cli.entry import _complain, build_parser
from goldfield_protocol import protocol_hash
from tests.host.fake_sensor import ATTITUDE, CHIPS, POSITION_M, SITE, beacon_fields

FIELD_COLUMNS = "epoch,t_s,beacon,bx_T,by_T,bz_T"
LOCATE_KEYS = ["epoch", "t_s", "position_m", "orientation_xyzw", "position_cov_m2", "attitude_cov_rad2"]
LOCATE_KEYS += ["residual", "status", "used", "excluded", "reason", "protection_m", "alternative", "beacons"]


def no_constants(name):
    raise AssertionError(f"{name} is no JSON")


def lines_of(capsys):
    return [json.loads(line, parse_constant=no_constants) for line in capsys.readouterr().out.splitlines()]


def fields_table(epochs=1, header=FIELD_COLUMNS):
    rows = [header]
    for epoch in range(epochs):
        for place, field in enumerate(beacon_fields()):
            rows.append(f"{epoch},{epoch * 0.1!r},b{place + 1}," + ",".join(repr(float(v)) for v in field))
    return rows


def samples_table(cycles=1, offset=0.5e-4, scale=1.0):
    samples = CHIPS @ beacon_fields() * scale + offset
    rows = ["chip,bx_T,by_T,bz_T"]
    rows += [
        f"{chip}," + ",".join(repr(float(v)) for v in row) for _ in range(cycles) for chip, row in enumerate(samples)
    ]
    return rows


def run(tmp_path, command, rows, *options):
    path = tmp_path / "table.csv"
    path.write_bytes(rows if isinstance(rows, bytes) else "\n".join(rows).encode())
    return main([command, "--site", str(SITE), str(path), *options])


def test_locate_finds_the_true_pose(tmp_path, capsys):
    assert run(tmp_path, "locate", fields_table(2), "--json") == 0
    first, second = lines_of(capsys)
    assert list(first) == LOCATE_KEYS
    assert (first["epoch"], second["epoch"], second["t_s"]) == (0, 1, 0.1)
    np.testing.assert_allclose(first["position_m"], POSITION_M, atol=1e-6)
    assert abs(np.dot(first["orientation_xyzw"], ATTITUDE.as_quat())) == pytest.approx(1.0, abs=1e-9)
    assert np.shape(first["position_cov_m2"]) == np.shape(first["attitude_cov_rad2"]) == (3, 3)
    assert (first["status"], first["used"], first["excluded"]) == ("ok", [f"b{i}" for i in range(1, 9)], [])


def test_every_epoch_gets_a_line_whatever_it_holds(tmp_path, capsys):
    rows = fields_table(1)
    rows += [
        "7,0.7,b1,,,",
        "8,0.8,b2,1e-7,1e-7,1e-7",
        "9,0.9,b1,nan,1e-7,1e-7",
        "9,0.9,b2,0,0,0",
        "10,1.0,b3,1e5,1e5,1e5",
    ]
    assert run(tmp_path, "locate", rows, "--json") == 0
    lines = lines_of(capsys)
    assert [line["epoch"] for line in lines] == [0, 7, 8, 9, 10]
    assert [line["status"] for line in lines] == ["ok"] + ["failed"] * 4
    for line in lines[1:]:
        assert list(line) == LOCATE_KEYS
        assert line["position_m"] is None
        assert line["orientation_xyzw"] is None


def test_columns_in_any_order_and_a_sigma(tmp_path, capsys):
    rows = [",".join([*reversed(row.split(",")), "2e-9" if i else "sigma_T"]) for i, row in enumerate(fields_table())]
    rows.insert(3, "")
    assert run(tmp_path, "locate", rows, "--json") == 0
    (line,) = lines_of(capsys)
    np.testing.assert_allclose(line["position_m"], POSITION_M, atol=1e-6)


def test_a_defect_in_location_costs_the_epoch_only(tmp_path, capsys, monkeypatch):
    def broken(*_):
        raise ZeroDivisionError("test")

    monkeypatch.setattr("goldfield.sensor.location.locate", broken)
    assert run(tmp_path, "locate", fields_table(2), "--json") == 0
    captured = capsys.readouterr()
    assert [json.loads(line)["status"] for line in captured.out.splitlines()] == ["failed", "failed"]
    assert captured.err.count("ZeroDivisionError: test") == 2


def test_tables_for_people(tmp_path, capsys):
    assert run(tmp_path, "locate", [*fields_table(1), "3,0.3,b1,,,"]) == 0
    header, ok, failed, reason, *summary = capsys.readouterr().out.splitlines()
    assert " ".join(header.split()) == "epoch x m y m z m roll pitch yaw sd cm n pl cm status"
    assert ok.split()[:4] == ["0", "0.900", "1.200", "0.800"]
    assert ok.endswith("  ok")
    assert failed.split() == ["3", *"-------", "0", "-", "failed"]
    assert summary == ["2 epochs: 1 ok, 1 failed", f"failed in 1 of 2: {reason.strip()}"]
    assert run(tmp_path, "separate", samples_table(1)) == 0
    out = capsys.readouterr().out.splitlines()
    assert (out[0], out[2].split()) == ("cycle 0", ["offset", "50000.000", "50000.000", "50000.000"])
    assert len(out) == 11


def test_separate_is_exact(tmp_path, capsys):
    assert run(tmp_path, "separate", samples_table(2), "--json") == 0
    lines = lines_of(capsys)
    assert [line["cycle"] for line in lines] == [0, 1]
    fields = beacon_fields()
    for line in lines:
        assert list(line) == ["cycle", "offset_T", "fields"]
        np.testing.assert_allclose(line["offset_T"], 0.5e-4, rtol=1e-12)
        assert [f["beacon"] for f in line["fields"]] == [f"b{i}" for i in range(1, 9)]
        assert all(list(f) == ["beacon", "b_T", "sigma_T"] for f in line["fields"])
        error = np.array([f["b_T"] for f in line["fields"]]) - fields
        assert np.abs(error).max() < 1e-9 * np.abs(fields).max()
        np.testing.assert_allclose([f["sigma_T"] for f in line["fields"]], 2e-7 / np.sqrt(1023), rtol=1e-3)


def test_separate_with_chips_counted_on_an_unmeasured_axis_and_a_rest(tmp_path, capsys):
    header, *rows = samples_table(2)
    rows = [",".join([str(i), row.split(",")[1], "", row.split(",")[3]]) for i, row in enumerate(rows)]
    assert run(tmp_path, "separate", [header, *rows[:2000]], "--json") == 0
    captured = capsys.readouterr()
    (line,) = [json.loads(text, parse_constant=no_constants) for text in captured.out.splitlines()]
    assert line["offset_T"][1] is None
    assert all(f["b_T"][1] is None and f["b_T"][0] is not None for f in line["fields"])
    assert "at its end 977 chips were left out" in captured.err


def site_of(tmp_path, codes):
    beacons = [
        f'[[beacon]]\nid = "{c}"\nposition_m = [0, 0, {c}]\naxis = [0, 0, 1]\nturns = 1\nradius_m = 0.1\n'
        f"current_A = 1.0\ncode = {c}\n"
        for c in codes
    ]
    path = tmp_path / "large.toml"
    head = '[site]\nname = "large"\nchip_period_s = 1e-4\ndegree = 5\n[sensor]\nnoise_T = 1e-9\n'
    path.write_text(head + "\n".join(beacons))
    return path


def test_a_singular_set_of_codes_names_the_site(tmp_path, capsys):
    path = site_of(tmp_path, range(33))
    assert main(["separate", "--site", str(path), "unused.csv"]) == 2
    message = capsys.readouterr().err
    assert 'large.toml: the fields of the beacons "0", "1", "2", "3", "4", "5" and ' in message
    assert "cannot be told apart in a cycle of 31 chips" in message


GOOD_ROW = "0,0.0,b1,1e-7,1e-7,1e-7"
BAD_FIELDS = [
    ([], "is empty"),
    (["", " "], "is empty"),
    (["chip,bx_T,by_T,bz_T", "0,1,2,3"], ':1: "chip" is no column'),
    (["epoch,t_s,beacon,bx_T,by_T"], ":1: the column bz_T is missing"),
    ([FIELD_COLUMNS + ",bx_T"], ":1: the column bx_T comes twice"),
    ([FIELD_COLUMNS], "has a header but no rows"),
    ([FIELD_COLUMNS, GOOD_ROW, "0,0.0,b2,1e-7"], ":3: has 4 cells where the header has 6"),
    ([FIELD_COLUMNS, "", GOOD_ROW, "0,0.0,b2,x,0,0"], ':4: bx_T is "x", not a number'),
    ([FIELD_COLUMNS, "0,0.0,b1,0,inf,0"], ':2: by_T is "inf"'),
    ([FIELD_COLUMNS, "0,0.0,b1,0,0,1e300"], ':2: bz_T is "1e300" tesla, beyond any field'),
    ([FIELD_COLUMNS, "0.5,0.0,b1,0,0,0"], ':2: epoch is "0.5", not a whole number'),
    ([FIELD_COLUMNS, "-1,0.0,b1,0,0,0"], ':2: epoch is "-1"'),
    ([FIELD_COLUMNS, ",0.0,b1,0,0,0"], ":2: epoch is empty"),
    ([FIELD_COLUMNS, "0,nan,b1,0,0,0"], ":2: t_s is not a number"),
    ([FIELD_COLUMNS, GOOD_ROW, "0,0.1,b2,0,0,0"], ":3: t_s differs from the 0 of the same epoch's first row (line 2)"),
    ([FIELD_COLUMNS, "0,0.0,b9,0,0,0"], ":2: beacon 'b9' is not in the site 'prigge8': it has b1, b2"),
    ([FIELD_COLUMNS, GOOD_ROW, GOOD_ROW], ":3: beacon 'b1' comes twice"),
    ([FIELD_COLUMNS, GOOD_ROW, "1,0.1,b1,0,0,0", "0,0.0,b2,0,0,0"], ":4: epoch 0 comes again"),
    ([FIELD_COLUMNS + ",sigma_T", GOOD_ROW + ",0"], ":2: sigma_T is 0"),
    ([FIELD_COLUMNS, '0,0.0,"b1,0,0,0'], "is no CSV"),
    (b"\x00\x01\x02\xff\xfe" * 100, "is no text"),
    (b"\x7fELF\x01\x01" * 100, "is no column"),
]
SAMPLE_COLUMNS = "chip,bx_T,by_T,bz_T"
BAD_SAMPLES = [
    ([SAMPLE_COLUMNS], "has 0 chips, fewer than a cycle's 1023"),
    ([SAMPLE_COLUMNS, "0,1e-6,2e-6,3e-6"], "has 1 chip, fewer than a cycle's 1023"),
    ([SAMPLE_COLUMNS, "0,1e-6,2e-6,3e-6", "2,1e-6,2e-6,3e-6"], ":3: chip is 2 where 1 follows"),
    ([SAMPLE_COLUMNS, "1,1,2,3"], ":2: chip is 1 where 0 follows"),
    ([FIELD_COLUMNS], 'table.csv:1: "epoch" is no column'),
]


@pytest.mark.parametrize(("rows", "words"), BAD_FIELDS)
def test_bad_tables_of_fields(tmp_path, capsys, rows, words):
    check_refused(tmp_path, capsys, "locate", rows, words)


@pytest.mark.parametrize(("rows", "words"), BAD_SAMPLES)
def test_bad_tables_of_samples(tmp_path, capsys, rows, words):
    check_refused(tmp_path, capsys, "separate", rows, words)


def check_refused(tmp_path, capsys, command, rows, words):
    assert run(tmp_path, command, rows, "--json") == 2
    message = capsys.readouterr().err
    assert message.startswith("goldfield: ")
    assert message.count("\n") == 1
    assert "table.csv" in message
    assert words in message


@settings(suppress_health_check=[HealthCheck.function_scoped_fixture], max_examples=60)
@given(st.binary(max_size=200) | st.text(alphabet=',\n"01.eb-x\r\t', max_size=100).map(str.encode))
def test_no_table_ends_in_a_traceback(tmp_path, capsys, content):
    for command, header in (("locate", FIELD_COLUMNS), ("separate", SAMPLE_COLUMNS)):
        assert run(tmp_path, command, header.encode() + b"\n" + content, "--json") in (0, 2)
        assert "defect" not in capsys.readouterr().err


def test_paths_that_are_no_table(tmp_path, capsys):
    for path, words in ((tmp_path / "none.csv", "there is no such CSV file"), (tmp_path, "is a directory")):
        assert main(["locate", "--site", str(SITE), str(path)]) == 2
        assert words in capsys.readouterr().err


def test_the_site_comes_from_the_environment_too(tmp_path, capsys, monkeypatch):
    path = tmp_path / "fields.csv"
    path.write_text("\n".join(fields_table()))
    assert main(["locate", str(path)]) == 2
    assert capsys.readouterr().err == "goldfield: --site is missing: give --site FILE or set GOLDFIELD_SITE\n"
    monkeypatch.setenv("GOLDFIELD_SITE", str(SITE))
    monkeypatch.setenv("GOLDFIELD_JSON", "1")
    assert main(["locate", str(path)]) == 0
    assert lines_of(capsys)[0]["status"] == "ok"


class Entry:
    """An entry point as importlib.metadata gives it."""

    def __init__(self, name, load):
        self.name, self.value, self.load = name, f"package:{name}", load


def test_commands_of_other_packages_and_broken_ones(capsys, monkeypatch):
    def good(subparsers):
        subparsers.add_parser("good").set_defaults(run=lambda arguments: 7)

    def missing():
        raise ModuleNotFoundError("no such module")

    def broken(subparsers):
        raise RuntimeError("half built")

    def twice(subparsers):
        subparsers.add_parser("run")

    entries = [Entry("good", lambda: good), Entry("missing", missing), Entry("broken", lambda: broken)]
    entries.append(Entry("twice", lambda: twice))
    monkeypatch.setattr("importlib.metadata.entry_points", lambda group: entries)
    assert main(["good"]) == 7
    assert main(["missing", "--any", "thing"]) == 3
    assert "ModuleNotFoundError: no such module" in capsys.readouterr().err
    assert main(["broken"]) == 3
    assert "RuntimeError: half built" in capsys.readouterr().err
    assert main(["locate", "x.csv"]) == 2
    assert "broken" in build_parser().format_help()


def test_the_last_resort_is_one_line(capsys, monkeypatch):
    def defect(_):
        raise IndexError("first\nsecond")

    monkeypatch.setattr("goldfield.cli.location_options.sites.load", defect)
    assert main(["locate", "--site", "x", "y"]) == 3
    message = capsys.readouterr().err
    assert message.startswith("goldfield: unexpected IndexError: first second; this is a defect")
    assert message.count("\n") == 1
    monkeypatch.setenv("GOLDFIELD_DEBUG", "1")
    assert main(["locate", "--site", "x", "y"]) == 3
    assert "Traceback" in capsys.readouterr().err
    assert _complain("a", 2) == 2


@pytest.mark.parametrize(
    ("arguments", "words"), [([], "COMMAND"), (["nonsense"], "invalid choice"), (["run", "--bad"], "--bad")]
)
def test_usage_errors_are_one_line(arguments, words):
    done = subprocess.run([sys.executable, "-m", "goldfield", *arguments], capture_output=True, text=True, check=False)
    assert done.returncode == 2
    assert done.stderr.count("\n") == 1
    assert words in done.stderr


def test_version_and_a_reader_that_goes_away(tmp_path):
    done = subprocess.run([sys.executable, "-m", "goldfield", "--version"], capture_output=True, text=True, check=True)
    assert done.stdout == f"goldfield 0.1.0, protocol {protocol_hash():#010x}\n"
    path = tmp_path / "many.csv"
    path.write_text("\n".join([FIELD_COLUMNS, *(f"{i},0,b1,,," for i in range(20000))]))
    command = [sys.executable, "-m", "goldfield", "locate", "--site", str(SITE), str(path), "--json"]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        assert process.stderr is not None
        assert json.loads(process.stdout.readline())["epoch"] == 0
        process.stdout.close()
        assert process.stderr.read() == ""
        assert process.wait() == 0
