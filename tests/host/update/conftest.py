"""Host boards that run an old image, and files of a new one."""

import struct

import pytest

from hil_sim import clib
from tests.firmware.core.boot.slots import CODE, NEW, OLD, Node
from tests.firmware.core.conftest import HEADERS
from tests.host.update.boards_on_a_link import BoardsLink, Seat


@pytest.fixture(scope="module")
def core():
    return clib.load("libgf_core.so", HEADERS)


@pytest.fixture
def bench(core):
    """Make sensors that run the old image, with the numbers 9, 10, ..."""
    made = []

    def make(count=1, running=None, prepare=lambda _: None, link=BoardsLink, **options):
        seats = []
        for place in range(count):
            node = Node(core, seed=place + 1)
            node.confirmed(OLD, (running or count * [0])[place], 7)
            prepare(node)
            seats.append(Seat(node, 9 + place, place))
        made.extend(seats)
        return link(seats, **options)

    yield make
    for seat in made:
        seat.close()


def slot_bytes(image, slot, words=None, **options):
    words = (image.at(slot).words(**options) if words is None else words)[: CODE + len(image.code)]
    data = struct.pack(f"<{len(words)}I", *words)
    return data + b"\xff" * (-len(data) % 8)


@pytest.fixture
def update_file(tmp_path):
    def make(image=NEW, *, change=None, **options):
        path = tmp_path / "new.gfi"
        data = bytearray(slot_bytes(image, 0, **options) + slot_bytes(image, 1, **options))
        if change is not None:
            change(data)
        path.write_bytes(data)
        return str(path)

    return make
