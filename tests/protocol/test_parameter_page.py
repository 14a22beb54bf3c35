"""The parameter page against the layout of framing.md, with a CRC and a table of its own."""

import re
import struct

import pytest
from hypothesis import given
from hypothesis import strategies as st

from goldfield_protocol.parameters import PARAMETERS, Kind, ParameterError, build_page, main, parse_page


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


def elements(parameter):
    if parameter.kind is Kind.FLOAT:
        return st.floats(float32(parameter.low), float32(parameter.high), width=32)
    return st.integers(int(parameter.low), int(parameter.high)).filter(lambda n: n != parameter.excluded)


def values(parameter):
    if parameter.count == 1:
        return elements(parameter)
    if parameter.rows > 1:
        row = st.lists(elements(parameter), min_size=parameter.group, max_size=parameter.group)
        return st.lists(row, min_size=1, max_size=parameter.rows).map(lambda rows: [x for row in rows for x in row])
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
        ({"node": 0}, "node is 0; it must be 1 to 4095"),
        ({"code": 3.5}, "code is 3.5; it must be a whole number, 0 to 2048"),
        ({"amplitude": float("nan")}, "amplitude is nan A; it must be 0 to 15.9 A"),
        ({"amplitude": 1e300}, "amplitude is 1e+300 A; it must be 0 to 15.9 A"),
        ({"amplitude": "10"}, "amplitude is '10'; it must be a number, 0 to 15.9 A"),
        ({"sync_master": True}, "sync_master is True; it must be a number, 0 to 1"),
        ({"amplitude": 100}, "amplitude is 100 A; it must be 0 to 15.9 A"),
        ({"calibration": [1.0] * 8}, "parameter 'calibration' got 8 values; it takes 9"),
        ({"code_list": [1] * 65}, "it takes at most 64"),
        ({"beacons": [1.0] * 12}, "parameter 'beacons' got 12 values; it takes 8 a row"),
        ({"degree": 8}, "degree is 8; it must be 5 to 11 and not 8"),
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


def test_a_parameter_that_is_given_twice_is_refused(tmp_path, capsys):
    page = tmp_path / "page.bin"
    assert main(["node=1", "code=2", "node=3", "-o", str(page)]) == 2
    assert capsys.readouterr().err == "error: parameter 'node' is given twice\n"
    assert not page.exists()


def test_a_name_in_capitals_is_told_its_own_parameter():
    with pytest.raises(ParameterError, match=r"^there is no parameter 'AMPLITUDE'; the nearest is 'amplitude'$"):
        build_page({"AMPLITUDE": 1.0})
