"""The firmware's parameters against the table of parameters.toml, and the stored page."""

import math
import struct

import crcmod.predefined
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from goldfield_protocol.parameters import PARAMETERS, Kind, ParameterError, build_page
from goldfield_protocol.table import ROLES

crc16 = crcmod.predefined.mkPredefinedCrcFun("crc-ccitt-false")
TABLE = {p.identifier(i): p.kind for p in PARAMETERS.values() for i in range(p.count)}


def bits(value):
    return struct.unpack("<I", struct.pack("<f", value))[0]


def page(entries, magic=0x31504647, crc=None, count=None):
    body = b"".join(struct.pack("<HHI", *entry) for entry in entries)
    header = struct.pack("<IHH", magic, len(entries) if count is None else count, crc16(body) if crc is None else crc)
    return (header + body).ljust(1024, b"\xff")


@pytest.fixture
def parameters(core):
    ffi, lib = core
    table = ffi.new("parameters_t *")
    lib.parameters_init(table)
    return table


def setting(core, table, identifier, kind, value):
    ffi, lib = core
    return lib.parameters_set(table, identifier, ffi.new("parameter_value_t *", [kind, value])[0])


def getting(core, table, identifier):
    ffi, lib = core
    value = ffi.new("parameter_value_t *")
    return lib.parameters_get(table, identifier, value), value.kind, value.bits


def load(core, table, stored):
    ffi, lib = core
    refused = ffi.new("uint32_t *", 99)
    return lib.parameters_load(table, stored, len(stored), refused), refused[0]


def test_exactly_the_documented_parameters_exist(core, parameters):
    assert len(TABLE) == 842
    for identifier in range(4096):
        status, kind, value = getting(core, parameters, identifier)
        if identifier in TABLE:
            assert (status, kind) == (0, TABLE[identifier])
            assert setting(core, parameters, identifier, kind, value) == 0  # A default is in range.
            assert setting(core, parameters, identifier, (kind + 1) % 3, value) == 3
        else:
            assert (status, kind, value) == (1, 0, 0)
            assert setting(core, parameters, identifier, 0, 0) == 1


@pytest.mark.parametrize(
    ("identifier", "inside", "outside"),
    [
        (0, [1, 4095], [0, 4096, 2**32 - 1]),
        (1, [0, 2048], [2049]),
        (3, [0, 15], [16]),
        (4, [0, 1], [2]),
        (5, [0, 64], [65]),
        (256, [0, 2048], [2049]),
        (319, [0, 2048], [2049]),
        (2, [0.0, 10.0, 15.9], [-0.1, 15.91, math.nan, math.inf]),
        (6, [0.0, 1.0], [-1e-9, 1.001, math.nan]),
        (7, [0.0, 15.9], [-1.0, 16.0, -math.inf]),
        (10, [0.0, 2047.5, 4095.0], [-0.5, 4095.5]),
        (24, [-1.0, 1e-7, 1.0], [1.001, math.nan]),
        (11, [0, 1], [2]),
        (13, [0, 4], [5]),
        (14, [1, 2047], [0, 2048]),
        (15, [0, 2046], [2047]),
        (25, [1, 1023], [0, 1024]),
        (26, [0, 3], [4]),
        (28, [5, 6, 7, 9, 10, 11], [0, 4, 8, 12, 2**32 - 1]),
        (320, [0, 11, 2048], [2049]),
        (320 + 8 * 3 + 3, [0, 2047], [2049]),
        (12, [0.0, 2e-7, 1.0], [-1e-9, 1.1, math.nan]),
        (37, [-1e6, 0.0, 1e6], [-1.1e6, math.inf]),
        (512, [-1e6, 0.0, 1e6], [1.1e6, math.nan]),
        (512 + 16 * 63 + 7, [-1e6, 0.0, 1e6], [1.1e6, math.nan]),
    ],
)
def test_ranges(core, parameters, identifier, inside, outside):
    kind = TABLE[identifier]
    encode = bits if kind == 2 else int
    for value in inside:
        assert setting(core, parameters, identifier, kind, encode(value)) == 0
        assert getting(core, parameters, identifier) == (0, kind, encode(value))
    for value in outside:
        assert setting(core, parameters, identifier, kind, encode(value)) == 2
        assert getting(core, parameters, identifier) == (0, kind, encode(inside[-1]))


def neighbours(parameter):
    """Values at both limits, just inside and just outside of them, around the excluded one, and odd ones: 32 bits each.

    Just outside of a float is the next single-precision number, of a whole number the next one, which may wrap.
    """
    if parameter.kind is Kind.FLOAT:
        low, high = np.float32(parameter.low), np.float32(parameter.high)
        ways = np.float32(-np.inf), np.float32(np.inf)
        ends = [value for end in (low, high) for value in (end, *(np.nextafter(end, way) for way in ways))]
        odd = [0.0, -0.0, np.inf, -np.inf, np.nan, -np.nan, np.finfo(np.float32).max, np.float32(1e-45)]
        return [bits(float(value)) for value in [*ends, *odd]]
    middle = [] if parameter.excluded is None else [parameter.excluded + i for i in (-1, 0, 1)]
    ends = [end + i for end in (parameter.low, parameter.high) for i in (-1, 0, 1)]
    return [value % 2**32 for value in (*ends, *middle, 2**31, 2**32 - 1)]


def built(parameter, element, number):
    """The page with the number as this element and defaults around it; None if the page builder refuses it."""
    if parameter.count == 1:
        values = number
    else:
        elements = parameter.count if parameter.exact else (element // parameter.group + 1) * parameter.group
        values = [parameter.default[i % parameter.group] for i in range(elements)]
        values[element] = number
    try:
        return build_page({parameter.name: values})
    except ParameterError as error:
        said = str(error)
    assert parameter.label(element) in said
    assert parameter.range_text in said
    return None


def chosen_elements(parameter):
    """Every element of small arrays; of large ones, the first and the last row."""
    whole = range(parameter.count)
    return whole if parameter.count <= 16 else [*whole[: parameter.group], *whole[-parameter.group :]]


@pytest.mark.parametrize("parameter", PARAMETERS.values(), ids=PARAMETERS)
def test_builder_and_firmware_take_and_refuse_the_same(core, parameters, parameter):
    """Each element at its limits and beside them: by the builder, by the page at start, and by PARAM_SET."""
    taken = {True: 0, False: 0}
    for element in sorted(set(chosen_elements(parameter))):
        identifier = parameter.identifier(element)
        for value in neighbours(parameter):
            status = setting(core, parameters, identifier, parameter.kind, value)
            stored = load(core, parameters, page([(identifier, parameter.kind, value)]))
            number = parameter.value(struct.pack("<I", value))
            made = built(parameter, element, number)
            assert status in (0, 2)
            assert stored == (0, int(status == 2))
            assert (made is not None) == (status == 0), (identifier, number)
            if made is not None:
                assert load(core, parameters, made) == (0, 0)
                assert getting(core, parameters, identifier) == (0, parameter.kind, value)
            taken[status == 0] += 1
        for kind in {*Kind, 3} - {parameter.kind}:
            valid = int.from_bytes(parameter.pack(parameter.default[element % parameter.group]), "little")
            assert setting(core, parameters, identifier, kind, valid) == 3
            assert load(core, parameters, page([(identifier, kind, valid)])) == (0, 1)
    every_word = parameter.kind is Kind.UNSIGNED and (parameter.low, parameter.high) == (0, 2**32 - 1)
    assert taken[True] > 0
    assert (taken[False] > 0) != every_word


def test_defaults_are_those_of_the_table(core, parameters):
    for parameter in PARAMETERS.values():
        for element in range(parameter.count):
            default = parameter.pack(parameter.default[element % parameter.group])
            assert getting(core, parameters, parameter.identifier(element))[2] == int.from_bytes(default, "little")


def test_entries_are_counted_out(core):
    ffi, lib = core
    for index, parameter in enumerate(PARAMETERS.values()):
        assert lib.parameters_entry(index).first_id == parameter.first
    assert lib.parameters_entry(len(PARAMETERS)) == lib.parameters_entry(2**32 - 1) == ffi.NULL


@pytest.mark.parametrize("role", ROLES)
def test_the_next_parameter_is_one_that_the_role_uses(core, role):
    ffi, lib = core
    used = [p for p in PARAMETERS.values() if role in p.roles]
    assert 0 < len(used) < len(PARAMETERS) or role == "anchor"
    for identifier in range(4096):
        entry = lib.parameters_next(identifier, ROLES[role])
        expected = next((p for p in used if p.first >= identifier), None)
        assert (entry == ffi.NULL) == (expected is None)
        if expected is not None:
            assert entry.first_id == expected.first
            assert ffi.string(entry.text).decode() == f"{expected.name} {expected.unit}".rstrip()


def test_degrees_are_those_that_have_codes(core, parameters):
    _, lib = core
    for degree in range(64):
        known = bool(lib.gold_family(degree))
        assert setting(core, parameters, PARAMETERS["degree"].first, Kind.UNSIGNED, degree) == (0 if known else 2)


def test_typed_readers_and_defaults(core, parameters):
    _, lib = core
    assert lib.parameters_unsigned(parameters, 0) == 1
    assert lib.parameters_float(parameters, 2) == 0.0  # Off.
    assert [lib.parameters_float(parameters, i) for i in (8, 9, 10)] == [2048.0] * 3
    assert lib.parameters_unsigned(parameters, 28) == 10
    nominal = [200e-6 / 2048 if i % 4 == 0 else 0.0 for i in range(9)]
    assert [lib.parameters_float(parameters, 16 + i) for i in range(9)] == pytest.approx(nominal)
    assert lib.parameters_unsigned(parameters, 8) == 0
    assert lib.parameters_float(parameters, 0) == 0.0
    assert lib.parameters_unsigned(parameters, 99) == 0


@given(data=st.data())
def test_a_good_page_sets_what_is_valid_and_counts_the_rest(core, data):
    ffi, lib = core
    table, model = ffi.new("parameters_t *"), ffi.new("parameters_t *")
    lib.parameters_init(table)
    lib.parameters_init(model)
    identifiers = st.one_of(st.sampled_from(sorted(TABLE)), st.integers(0, 65535))
    values = st.one_of(st.integers(0, 2**32 - 1), st.integers(0, 70), st.floats(-2, 2, width=32).map(bits))
    entries = data.draw(st.lists(st.tuples(identifiers, st.sampled_from([0, 1, 2, 256, 258]), values), max_size=127))
    refused = 0
    for identifier, kind, value in entries:
        refused += kind > 2 or setting(core, model, identifier, kind, value) != 0
    assert load(core, table, page(entries)) == (0, refused)
    assert bytes(ffi.buffer(table)) == bytes(ffi.buffer(model))


GOOD = page([(0, 0, 7), (1, 0, 12), (2, 2, bits(3.0))])


@pytest.mark.parametrize(
    ("stored", "result"),
    [
        (b"\xff" * 1024, 1),
        (b"\0" * 1024, 2),
        (b"", 2),
        (b"\xff" * 7, 2),
        (GOOD[:7], 2),
        (GOOD[:31], 2),  # Count says more than there is.
        (page([(0, 0, 7)], magic=0x31504648), 2),
        (page([(0, 0, 7)], crc=0x1234), 2),
        (page([(0, 0, 7)], count=65535), 2),
        (page([(0, 0, 7)] * 127, count=128), 2),
    ],
)
def test_a_bad_page_changes_nothing(core, parameters, stored, result):
    ffi, _ = core
    before = bytes(ffi.buffer(parameters))
    assert load(core, parameters, stored) == (result, 0)
    assert bytes(ffi.buffer(parameters)) == before


def test_a_page_ends_where_it_is_said_to_end(core, parameters):
    """The bytes behind it are those that it would need."""
    ffi, lib = core
    refused = ffi.new("uint32_t *")
    for size, result in ((7, 2), (8, 2), (31, 2), (32, 0), (33, 0)):
        assert lib.parameters_load(parameters, GOOD, size, refused) == result, size
    for empty, results in ((page([]), (2, 0)), (b"\xff" * 9, (2, 1))):
        assert tuple(lib.parameters_load(parameters, empty, size, refused) for size in (7, 8)) == results


@given(position=st.integers(0, len(GOOD.rstrip(b"\xff")) - 1), flip=st.integers(0, 7))
def test_one_flipped_bit_spoils_the_page(core, position, flip):
    ffi, lib = core
    table = ffi.new("parameters_t *")
    lib.parameters_init(table)
    spoiled = bytearray(GOOD)
    spoiled[position] ^= 1 << flip
    assert load(core, table, bytes(spoiled))[0] == 2
    assert lib.parameters_unsigned(table, 0) == 1


def test_a_value_that_nobody_has_set_breaks_the_seal(core, parameters):
    """Each bit of any value, two values that have changed places, and memory that is 0 all over."""
    ffi, lib = core
    assert lib.parameters_intact(parameters)
    assert setting(core, parameters, PARAMETERS["over_current"].identifier(0), 2, bits(3.5)) == 0
    assert setting(core, parameters, PARAMETERS["over_current"].identifier(0), 2, bits(99.0)) != 0
    assert load(core, parameters, page([(PARAMETERS["code"].identifier(0), 0, 17)])) == (0, 0)
    assert lib.parameters_intact(parameters)
    for place in (0, 1, 417, 839):
        for bit in range(32):
            parameters.bits[place] ^= 1 << bit
            assert not lib.parameters_intact(parameters), (place, bit)
            parameters.bits[place] ^= 1 << bit
    parameters.bits[1], parameters.bits[7] = parameters.bits[7], parameters.bits[1]
    assert not lib.parameters_intact(parameters)
    assert not lib.parameters_intact(ffi.new("parameters_t *"))
