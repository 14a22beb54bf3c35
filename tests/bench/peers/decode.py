"""Messages from frames, and frames from serial bytes: `goldfield_protocol` beside cantools, which reads any DBC."""

from __future__ import annotations

import random

from goldfield_protocol import FrameDecoder, decode, encode_frame
from goldfield_protocol.messages import TYPE_MASK, Identifier, database, shapes
from tests.bench.peers.bench import Bench, named
from tests.bench.peers.row import Goal, Row

SUBJECT = "decode"
CYCLES = 20
OF_A_CYCLE = ("EPOCH", "EPOCH_STATUS", "EPOCH_OFFSET", *["FIELD"] * 8)
OF_A_BLOCK = ("BLOCK", *["BLOCK_SUM"] * 8)
BLOCKS = 33
LEAST = 100_000
"""Messages a second that the issue asks for."""


def frames(names: tuple[str, ...], seed: int = 1) -> list[tuple[int, bytes]]:
    """Return frames with random signals, whatever these say: identifier and data."""
    rng, found = random.Random(seed), []
    for number, name in enumerate(names):
        message = database().get_message_by_name(name)
        type_ = Identifier.unpack(message.frame_id).type
        index = min(2 + number % 8, shapes()[type_].largest_index)
        found.append((Identifier(type_, index, 100).pack(), rng.randbytes(message.length)))
        assert decode(*found[-1]) is not None
    return found


def rows(bench: Bench) -> list[Row]:
    """Return the rows of the subject."""
    known, found = database(), []
    kinds = {
        "messages of cycles of 8 beacons": OF_A_CYCLE * CYCLES * 4,
        "messages of blocks and cycles of 8 beacons": (*OF_A_CYCLE, *OF_A_BLOCK * BLOCKS) * 3,
    }
    for what, names in kinds.items():
        some = frames(names)

        def ours(some: list[tuple[int, bytes]] = some) -> object:
            return [decode(identifier, data) for identifier, data in some]

        def theirs(some: list[tuple[int, bytes]] = some) -> object:
            return [known.decode_message(number & TYPE_MASK, data, decode_choices=False) for number, data in some]

        row = bench.pair(
            SUBJECT,
            what,
            ours,
            named("cantools"),
            theirs,
            unit="messages/s",
            work=len(some),
            goal=Goal("ours", at_least=LEAST),
        )
        found.append(row)
        line = b"".join(encode_frame(*frame) for frame in some)

        def from_bytes(line: bytes = line) -> object:
            return [decode(frame.identifier, frame.data) for frame in FrameDecoder().feed(line)]

        found.append(
            bench.pair(
                SUBJECT,
                f"{what}, from serial bytes",
                from_bytes,
                f"{named('cantools')} behind the same frames",
                theirs_of(line),
                unit="messages/s",
                work=len(some),
                goal=Goal("ours", at_least=LEAST),
            )
        )
    return found


def theirs_of(line: bytes):  # type: ignore[no-untyped-def]
    """Return a task that takes the bytes of a line apart as we do and has cantools decode the frames."""
    known = database()
    return lambda: [
        known.decode_message(frame.identifier & TYPE_MASK, frame.data, decode_choices=False)
        for frame in FrameDecoder().feed(line)
    ]
