"""The table of parameters and counters: well formed, without clashes, and told alike by the page in the docs."""

import struct
from pathlib import Path

import pytest

from goldfield_protocol.c_tables import rates_header, table_header
from goldfield_protocol.messages import database
from goldfield_protocol.parameters import COUNTERS, PARAMETERS, Kind, ParameterError, counter_name, find_id, label_of
from goldfield_protocol.parameters_doc import page
from goldfield_protocol.rates import CAN_RATES, SERIAL_RATES
from goldfield_protocol.table import ROLES

PAGE = Path(__file__).parents[2] / "docs" / "parameters.md"


def test_the_roles_are_those_of_the_heartbeat():
    named = database().get_message_by_name("HEARTBEAT").get_signal_by_name("role").choices
    assert {number: str(name) for number, name in named.items()} == {n: r for r, n in ROLES.items()} | {2: "host"}


def test_the_page_in_the_docs_is_what_the_generator_prints():
    assert PAGE.read_text(encoding="utf-8") == page(), "write it: python -m goldfield_protocol.parameters_doc " + str(
        PAGE.relative_to(PAGE.parents[1])
    )


def test_ids_are_in_order_and_belong_to_one_parameter():
    ids = [p.identifier(i) for p in PARAMETERS.values() for i in range(p.count)]
    assert len(ids) == len(set(ids)) == 842
    assert list(PARAMETERS.values()) == sorted(PARAMETERS.values(), key=lambda p: p.first)
    assert 0 <= min(ids) < max(ids) <= 4095
    assert [c.index for c in COUNTERS] == list(range(len(COUNTERS)))


@pytest.mark.parametrize("parameter", PARAMETERS.values(), ids=PARAMETERS)
def test_a_parameter_is_well_formed(parameter):
    assert parameter.low < parameter.high
    assert len(parameter.units) == len(parameter.default) == parameter.group
    assert set(parameter.roles) <= set(ROLES)
    assert (parameter.rows > 1) == (parameter.stride > 0)
    assert parameter.rows == 1 or parameter.stride >= parameter.group
    assert max(parameter.group, parameter.rows) <= 255
    assert parameter.stride <= 31  # as the DBC packs them
    for element, value in enumerate(parameter.default):
        parameter.bits(value, element)
    if parameter.excluded is not None:
        assert parameter.kind is Kind.UNSIGNED
        assert 1 <= parameter.excluded <= 255
        assert parameter.low < parameter.excluded < parameter.high


@pytest.mark.parametrize(("name", "rates"), [("can_rate", CAN_RATES), ("serial_rate", SERIAL_RATES)])
def test_each_value_of_a_rate_has_its_bits_a_second(name, rates):
    assert (PARAMETERS[name].low, PARAMETERS[name].high) == (0, len(rates) - 1)
    macro = name.upper() + "S"
    assert (
        f"#define {macro}_COUNT {len(rates)}u\n#define {macro} {{{', '.join(f'{r}u' for r in rates)}}}"
        in rates_header()
    )


@pytest.mark.parametrize("text", [p.text for p in PARAMETERS.values()] + [c.text for c in COUNTERS])
def test_a_text_is_a_sentence(text):
    assert text[0].isupper()
    assert text.endswith(".")
    assert not text.startswith("Of ")


def test_a_description_fits_eight_messages():
    for parameter in PARAMETERS.values():
        text = f"{parameter.name} {parameter.unit}".rstrip()
        assert text.isascii()
        assert f'"{text}"' in table_header()
        assert 2 + -(-len(text) // 7) <= 8


def test_what_is_refused_is_named_with_value_range_and_unit():
    with pytest.raises(ParameterError) as told:
        PARAMETERS["amplitude"].bits(100)
    assert str(told.value) == "amplitude is 100 A; it must be 0 to 15.9 A"
    with pytest.raises(ParameterError) as told:
        PARAMETERS["beacons"].bits(2e6, 14)
    assert str(told.value) == "beacons[1][6] is 2000000 A m^2; it must be -1000000 to 1000000"
    with pytest.raises(ParameterError) as told:
        PARAMETERS["degree"].bits(8)
    assert str(told.value) == "degree is 8; it must be 5 to 11 and not 8"


def test_ids_are_told_by_name():
    assert label_of(2) == "amplitude"
    assert label_of(258) == "code_list[2]"
    assert label_of(512 + 16 * 63 + 7) == "beacons[63][7]"
    assert label_of(200) == "200"
    assert find_id(49) is None
    assert find_id(320 + 4) is None  # between two rows
    assert counter_name(0) == "serial frames dropped"
    assert counter_name(99) == "of counter 99"


def test_single_precision_decides_as_on_a_board():
    limit = struct.unpack("<f", struct.pack("<f", 15.9))[0]
    assert limit < 15.9
    over = struct.unpack("<f", struct.pack("<I", struct.unpack("<I", struct.pack("<f", limit))[0] + 1))[0]
    amplitude = PARAMETERS["amplitude"]
    assert amplitude.bits(15.9) == amplitude.bits(limit) == struct.pack("<f", limit)
    assert amplitude.bits(15.9 + 1e-8) == amplitude.bits(15.9)  # It is stored as the limit.
    with pytest.raises(ParameterError):
        amplitude.bits(over)
