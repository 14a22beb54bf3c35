"""A saved set of parameters, as this image writes it, and as older and newer images do."""

import struct

import pytest
from hypothesis import given
from hypothesis import strategies as st

from goldfield_protocol.parameters import PARAMETERS
from tests.firmware.core.edge_memory import at_the_edge

MARK, FORMAT = 0x50415200, 1
VERSION = 0x00010203
LOADED, OTHER, BAD = range(3)
UNSIGNED, SIGNED, FLOAT = range(3)
MOST = 2 + sum(p.count + p.rows for p in PARAMETERS.values())
IDS = {p.identifier(i): p for p in PARAMETERS.values() for i in range(p.count)}


def run(first, kind, *values):
    return [first | kind << 12 | len(values) << 16, *values]


def words(*runs, mark=MARK | FORMAT):
    return [mark, VERSION, *(word for one in runs for word in one)]


def read_by_another_hand(written):
    """Return the values by id, by the text of parameter_set.h."""
    found, index = {}, 2
    while index < len(written):
        head = written[index]
        for i in range(head >> 16):
            found[(head & 0xFFF) + i] = (head >> 12 & 0xF, written[index + 1 + i])
        index += 1 + (head >> 16)
    assert index == len(written)
    return found


@pytest.fixture
def parameters(core):
    return defaults(core)


def defaults(core):
    ffi, lib = core
    table = ffi.new("parameters_t *")
    lib.parameters_init(table)
    return table


def write(core, table):
    ffi, lib = core
    room = ffi.new("uint32_t[]", MOST)
    return list(room[0 : lib.parameter_set_write(table, VERSION, room)])


def read(core, table, stored):
    ffi, lib = core
    refused = ffi.new("uint32_t *", 99)
    memory = ffi.from_buffer("uint32_t[]", at_the_edge(4 * len(stored), struct.pack(f"<{len(stored)}I", *stored)))
    return lib.parameter_set_read(table, memory, len(stored), refused), refused[0]


def value(core, table, identifier):
    ffi, lib = core
    told = ffi.new("parameter_value_t *")
    assert lib.parameters_get(table, identifier, told) == 0
    return told.kind, told.bits


def put(core, table, identifier, kind, bits):
    ffi, lib = core
    assert lib.parameters_set(table, identifier, ffi.new("parameter_value_t *", [kind, bits])[0]) == 0


def test_every_parameter_is_in_the_set_with_its_kind_and_its_value(core, parameters):
    put(core, parameters, 0, UNSIGNED, 77)
    put(core, parameters, 1538, FLOAT, struct.unpack("<I", struct.pack("<f", 0.25))[0])  # Not the first of a row.
    written = write(core, parameters)
    assert written[:2] == [MARK | FORMAT, VERSION]
    assert len(written) == MOST  # What PARAMETER_SET_WORDS promises.
    found = read_by_another_hand(written)
    assert found.keys() == IDS.keys()
    assert all(found[identifier] == value(core, parameters, identifier) for identifier in IDS)
    assert found[0] == (UNSIGNED, 77)


def test_a_set_that_was_written_is_read_back(core, parameters):
    for identifier, parameter in IDS.items():
        if parameter.name not in ("node", "degree"):
            put(core, parameters, identifier, parameter.kind, int.from_bytes(parameter.pack(parameter.high), "little"))
    other = defaults(core)
    assert read(core, other, write(core, parameters)) == (LOADED, 0)
    assert write(core, other) == write(core, parameters)


def test_a_newer_image_s_set_gives_what_this_image_knows(core, parameters):
    """Ids that do not exist, before, between and behind those that do, a kind that does not, and a larger range."""
    stored = words(
        run(1, UNSIGNED, 55),
        run(27, UNSIGNED, 1, 9, 10),  # 27 is free; 28 is the degree, for which 9 is good; 29 is a float.
        run(200, 7, 1, 2, 3),
        run(4, UNSIGNED, 2),  # stream: 0 or 1
        run(4090, FLOAT, *range(20)),  # beyond the last id
        run(5, UNSIGNED, 3),
    )
    assert read(core, parameters, stored) == (LOADED, 2 + 3 + 1 + 20)
    assert [value(core, parameters, i)[1] for i in (1, 28, 4, 5)] == [55, 9, 0, 3]


def test_an_older_image_s_set_leaves_what_it_did_not_know(core, parameters):
    put(core, parameters, 44, UNSIGNED, 3)
    assert read(core, parameters, words(run(0, UNSIGNED, 8, 5))) == (LOADED, 0)
    assert [value(core, parameters, i)[1] for i in (0, 1, 44)] == [8, 5, 3]


@pytest.mark.parametrize(
    ("stored", "what"),
    [
        ([], OTHER),
        ([MARK | FORMAT], OTHER),
        (words(run(1, UNSIGNED, 5), mark=MARK | FORMAT + 1), OTHER),
        (words(run(1, UNSIGNED, 5), mark=0x47415200 | FORMAT), OTHER),
        (words(run(1, UNSIGNED, 5))[:-1], BAD),
        (words(run(1, UNSIGNED, 5), run(2, UNSIGNED)), BAD),
        ([*words(run(1, UNSIGNED, 5)), 1 | 0xFFFF << 16], BAD),
    ],
)
def test_a_set_that_cannot_be_read_changes_nothing(core, parameters, stored, what):
    before = write(core, parameters)
    assert read(core, parameters, stored) == (what, 0)
    assert write(core, parameters) == before


@given(
    stored=st.lists(st.one_of(st.integers(0, 0xFFFFFFFF), st.integers(0, 0x5FFFF)), max_size=40), headed=st.booleans()
)
def test_any_words_are_survived(core, stored, headed):
    table = defaults(core)
    what, refused = read(core, table, [MARK | FORMAT, VERSION, *stored] if headed else stored)
    assert what == LOADED or refused == 0
    for identifier, parameter in IDS.items():
        assert parameter.low <= parameter.value(struct.pack("<I", value(core, table, identifier)[1])) <= parameter.high


def test_an_empty_set_is_good(core, parameters):
    before = write(core, parameters)
    assert read(core, parameters, words()) == (LOADED, 0)
    assert write(core, parameters) == before


def test_each_word_that_is_not_the_parameters_own_is_seen(core, parameters):
    ffi, lib = core
    put(core, parameters, 0, UNSIGNED, 77)
    written = write(core, parameters)
    assert lib.parameter_set_holds(parameters, VERSION, ffi.new("uint32_t[]", written))
    assert not lib.parameter_set_holds(parameters, VERSION + 1, ffi.new("uint32_t[]", written))
    for index in range(MOST):
        other = [word ^ (1 << index % 32 if place == index else 0) for place, word in enumerate(written)]
        assert not lib.parameter_set_holds(parameters, VERSION, ffi.new("uint32_t[]", other)), index
    put(core, parameters, 0, UNSIGNED, 78)
    assert not lib.parameter_set_holds(parameters, VERSION, ffi.new("uint32_t[]", written))
