"""The answer to a challenge: its hash against RFC 4231, the whole against the vectors that the host reads as well."""

from __future__ import annotations

import hmac
import json

import pytest

from hil_sim import clib
from tests.firmware.core.edge_memory import at_the_edge

VECTORS = json.loads((clib.ROOT / "protocol/vectors/access.json").read_text())["answers"]


def test_the_hash_is_that_of_rfc_4231() -> None:
    """Cases 1 and 2 of the RFC, on the firmware's implementation and on Python's."""
    ffi, library = clib.load("libgf_core.so", ["third_party/monocypher/monocypher-ed25519.h"])
    cases = {
        (20 * b"\x0b", b"Hi There"): "87aa7cdea5ef619d4ff0b4241a1d6cb02379f4e2ce4ec2787ad0b30545e17cde"
        "daa833b7d6b8a702038b274eaea3f4e4be9d914eeb61f1702e696c203a126854",
        (b"Jefe", b"what do ya want for nothing?"): "164b7a7bfcf819e2e395fbe73b56e0a387bd64222e831fd610270cd7ea250554"
        "9758bf75c05a994a6d034f65f8f0e6fdcaeab1a34d4a6b4b636e070a38bce737",
    }
    for (key, data), expected in cases.items():
        hashed = ffi.new("uint8_t[64]")
        library.crypto_sha512_hmac(hashed, key, len(key), data, len(data))
        assert bytes(hashed).hex() == hmac.digest(key, data, "sha512").hex() == expected


@pytest.mark.parametrize("vector", VECTORS, ids=lambda one: one["name"])
def test_answers_are_those_of_the_vectors(vector: dict[str, str]) -> None:
    ffi, library = clib.load("libgf_core.so", ["core/link/challenge.h"])
    key, unique_id, number, answer = (bytes.fromhex(vector[n]) for n in ("key", "unique_id", "number", "answer"))
    key, unique_id = (ffi.from_buffer("uint8_t[]", at_the_edge(len(what), what)) for what in (key, unique_id))
    told = library.challenge_answer(key, unique_id, int.from_bytes(number, "little"))
    assert told.to_bytes(8, "little") == answer
