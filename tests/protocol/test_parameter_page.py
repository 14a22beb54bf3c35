"""The parameter page against the layout of framing.md, with a CRC and a table of its own."""

import re
import struct
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from goldfield_protocol.parameters import PARAMETERS, Kind, ParameterError, build_page, main, parse_page

FRAMING = Path(__file__).resolve().parents[2] / "protocol" / "framing.md"


def bitwise_crc16(data):
    crc = 0xFFFF
    for byte in data:
        crc ^= byte << 8
        for _ in range(8):
            crc = (crc << 1 ^ 0x1021 if crc & 0x8000 else crc << 1) & 0xFFFF
    return crc


def float32(value):
    return struct.unpack("<f", struct.pack("<f", value))[0]


def test_bytes_of_a_small_page():
    page = build_page({"code_list": [1018, 3], "node": 7, "amplitude": 1.5})
    entries = struct.pack("<HHI HHf HHI HHI", 0, 0, 7, 2, 2, 1.5, 256, 0, 1018, 257, 0, 3)
    assert page == b"GFP1" + struct.pack("<HH", 4, bitwise_crc16(entries)) + entries + b"\xff" * (8192 - 8 - 32)


def test_table_is_that_of_framing_md():
    text = FRAMING.read_text().split("## Parameters")[1].split("## Counters")[0]
    documented, tables = {}, set()
    for first, stride, last, name, kind, last_row in re.findall(
        r"^\| (\d+) \+ (\d+) i \+ 0\.\.(\d+) \| (\w+) \| (\w+) \|.*i = 0\.\.(\d+)", text, re.MULTILINE
    ):
        table = PARAMETERS[name]
        assert (table.first, table.stride, table.group - 1) == (int(first), int(stride), int(last))
        assert (table.count, table.kind.name.lower()) == (table.group * (int(last_row) + 1), kind)
        tables.add(name)
    for first, last, names, kind in re.findall(r"^\| (\d+)(?:\.\.(\d+))? \| ([\w, ]+) \| (\w+) \|", text, re.MULTILINE):
        ids = range(int(first), int(last or first) + 1)
        names = names.split(", ")
        share = len(ids) // len(names)
        for i, name in enumerate(names):
            documented[name] = (ids[i * share], share, kind)
    assert tables == {n for n, p in PARAMETERS.items() if p.stride > 1}
    assert documented == {n: (p.first, p.count, p.kind.name.lower()) for n, p in PARAMETERS.items() if p.stride == 1}


def elements(parameter):
    low, high = max(parameter.low, -1e6), min(parameter.high, 1e6)
    if parameter.kind is Kind.FLOAT:
        return st.floats(low, high, width=32)
    return st.sampled_from([n for n in range(int(low), int(high) + 1) if n not in parameter.excluded])


def values(parameter):
    if parameter.count == 1:
        return elements(parameter)
    if parameter.group > 1:
        row = st.lists(elements(parameter), min_size=parameter.group, max_size=parameter.group)
        return st.lists(row, min_size=1, max_size=parameter.count // parameter.group).map(
            lambda rows: [x for row in rows for x in row]
        )
    return st.lists(elements(parameter), min_size=parameter.count if parameter.exact else 1, max_size=parameter.count)


@given(st.fixed_dictionaries({}, optional={name: values(p) for name, p in PARAMETERS.items()}))
def test_parse_inverts_build(chosen):
    page = build_page(chosen)
    assert len(page) == 8192
    assert parse_page(page) == chosen


@given(st.integers(0, 8 + 3 * 8 - 1), st.integers(1, 255))
def test_any_changed_byte_is_noticed(position, change):
    page = bytearray(build_page({"node": 7, "zero_x": 2048.25, "stream": 1}))
    page[position] ^= change
    with pytest.raises(ParameterError):
        parse_page(bytes(page))


@pytest.mark.parametrize(
    ("wrong", "sentence"),
    [
        ({"nod": 7}, "there is no parameter 'nod'; the nearest is 'node'"),
        ({"node": 0}, "parameter 'node' is 0; it must lie in 1 to 4095"),
        ({"code": 3.5}, "parameter 'code' is 3.5; it must be a whole number"),
        ({"amplitude": float("nan")}, "must be a finite number"),
        ({"amplitude": 1e300}, "does not fit 32 bits"),
        ({"calibration": [1.0] * 8}, "parameter 'calibration' got 8 values; it takes 9"),
        ({"code_list": [1] * 65}, "it takes at most 64"),
        ({"beacons": [1.0] * 12}, "parameter 'beacons' got 12 values; it takes 8 a row"),
        ({"degree": 8}, "parameter 'degree' is 8; of 5 to 11 that is not allowed"),
        ({"codes": [5, 0, 0]}, "parameter 'codes' got 3 values; it takes 4 a row"),
        ({"node": [1, 2]}, "parameter 'node' got 2 values; it takes 1"),
    ],
)
def test_bad_values_are_sentences(wrong, sentence):
    with pytest.raises(ParameterError, match=re.escape(sentence)):
        build_page(wrong)


@pytest.mark.parametrize("page", [b"", b"\xff" * 1024, build_page({"node": 7})[:12]])
def test_no_page_is_an_error(page):
    with pytest.raises(ParameterError):
        parse_page(page)


def test_command_line(tmp_path, capsys):
    path = tmp_path / "page.bin"
    assert main(["node=0x11", "zero_y=2047.5", "code_list=3,17,40", "-o", str(path)]) == 0
    assert parse_page(path.read_bytes()) == {"node": 17, "zero_y": 2047.5, "code_list": [3, 17, 40]}
    assert main(["--show", str(path)]) == 0
    assert capsys.readouterr().out == "node=17\nzero_y=2047.5\ncode_list=3,17,40\n"


@pytest.mark.parametrize("arguments", [["node"], ["node=x", "-o", "p"], ["nope=1", "-o", "p"], ["node=1"]])
def test_bad_command_line_is_one_line_and_exit_2(arguments, capsys, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert main(arguments) == 2
    error = capsys.readouterr().err
    assert error.startswith("error: ")
    assert error.count("\n") == 1
    assert not list(tmp_path.iterdir())
