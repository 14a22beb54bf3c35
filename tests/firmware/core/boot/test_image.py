"""An image's check: every bit counts, each thing that is wrong has its own status, and signatures are Ed25519."""

from __future__ import annotations

import random
from dataclasses import replace

import cffi
import pytest
from cryptography.exceptions import InvalidSignature
from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey, Ed25519PublicKey
from hypothesis import given
from hypothesis import strategies as st

from hil_sim import clib
from tests.firmware.core.boot.slots import (
    BEACON,
    CODE,
    CRC,
    DAMAGED,
    HEADER,
    NEW,
    NO_KEY,
    NONE,
    OK,
    OLD,
    OLDER,
    OTHER_KEY,
    SENSOR,
    SIGNATURE,
    STATE_WORDS,
    UNSIGNED,
    WORDS,
    WRONG_BOARD,
    WRONG_PLACE,
    WRONG_ROLE,
    Choice,
    Image,
    Node,
    public,
)
from tests.firmware.core.storage.flash_cells import ONES

# RFC 8032, 7.1, tests 1 to 3: secret key, public key, message, signature.
RFC_8032 = [
    (
        "9d61b19deffd5a60ba844af492ec2cc44449c5697b326919703bac031cae7f60",
        "d75a980182b10ab7d54bfed3c964073a0ee172f3daa62325af021a68f707511a",
        "",
        "e5564300c360ac729086e2cc806e828a84877f1eb8e5d974d873e065224901555fb8821590a33bacc61e39701cf9b46b"
        "d25bf5f0595bbe24655141438e7a100b",
    ),
    (
        "4ccd089b28ff96da9db6c346ec114e0f5b8a319f35aba624da8cf6ed4fb8a6fb",
        "3d4017c3e843895a92b70aa74d1b7ebc9c982ccf2ec4968cc0cd55f12af4660c",
        "72",
        "92a009a9f0d4cab8720e820b5f642540a2b27b5416503f8fb3762223ebdb69da085ac1e43e15996e458f3613d0f11d8c"
        "387b2eaeb4302aeeb00d291612bb0c00",
    ),
    (
        "c5aa8df43f9f837bedb7442f31dcb7b166d38535076f094b85ce3a2e0b4458f7",
        "fc51cd8e6218a1a38da47ed00230f0580816ed13ba3303ac5deb911548908025",
        "af82",
        "6291d657deec24024827e69c3abe01a30ce548a284743a445e3680d7db5ac3ac18ff9b538d16f290ae67f760984dc659"
        "4a7c15e9716ed28dc027beceea1ec40a",
    ),
]


@pytest.fixture(scope="module")
def ed25519():
    ffi = cffi.FFI()
    ffi.cdef("int crypto_ed25519_check(const uint8_t *, const uint8_t *, const uint8_t *, size_t);")
    library = ffi.dlopen(str(clib.built("libgf_core.so")))
    return lambda signature, key, message: library.crypto_ed25519_check(signature, key, message, len(message)) == 0


@pytest.mark.parametrize(("secret", "key", "message", "signature"), RFC_8032)
def test_the_vectors_of_the_standard(ed25519, secret, key, message, signature):
    secret, key, message, signature = (bytes.fromhex(word) for word in (secret, key, message, signature))
    assert public(Ed25519PrivateKey.from_private_bytes(secret)) == key
    assert Ed25519PrivateKey.from_private_bytes(secret).sign(message) == signature
    assert ed25519(signature, key, message)
    for bit in range(512):
        wrong = bytearray(signature)
        wrong[bit // 8] ^= 1 << bit % 8
        assert not ed25519(bytes(wrong), key, message)
    assert not ed25519(signature, key, message + b"\0")
    assert not ed25519(signature, public(OTHER_KEY), message)


def test_signatures_are_judged_as_another_implementation_judges_them(ed25519):
    chance = random.Random(4)
    good = 0
    for number in range(200):
        key = Ed25519PrivateKey.from_private_bytes(chance.randbytes(32))
        message = bytearray(chance.randbytes(chance.choice([0, 1, 63, 64, 111, 112, 127, 128, 129, 1000])))
        signature = bytearray(key.sign(bytes(message)))
        if number % 2:
            changed = signature if number % 4 == 1 or not message else message
            changed[chance.randrange(len(changed))] ^= 1 << chance.randrange(8)
        try:
            Ed25519PublicKey.from_public_bytes(public(key)).verify(bytes(signature), bytes(message))
            expected = True
        except InvalidSignature:
            expected = False
        good += expected
        assert ed25519(bytes(signature), public(key), bytes(message)) == expected
    assert good == 100


def test_a_good_image_passes_in_each_slot(core):
    node = Node(core)
    for slot in range(2):
        node.put(NEW, slot)
        assert node.check(slot, SENSOR, NEW.version) == OK
        assert node.intact(slot)


def test_every_bit_counts_and_state_words_do_not(core):
    node = Node(core)
    node.put(OLD, 0)
    end = CODE + len(OLD.code)
    for index in range(WORDS):
        for bit in range(32):
            node.cells.read[0][index] ^= 1 << bit
            status = node.check(0)
            node.cells.read[0][index] ^= 1 << bit
            if index in range(SIGNATURE, CRC):
                assert status == UNSIGNED, (index, bit)
            elif index == HEADER:
                assert status == NONE
            elif index == HEADER + 1:
                assert status in (NONE, DAMAGED)
            elif index == CRC or index in range(HEADER, end):
                assert status == DAMAGED, (index, bit)
            else:
                assert index < STATE_WORDS or index in range(CRC + 1, HEADER) or index >= end
                assert status == OK, (index, bit)
    assert node.check(0) == OK


@pytest.mark.parametrize(
    ("image", "status"),
    [
        (replace(OLD, board=2), WRONG_BOARD),
        (replace(OLD, role=BEACON), WRONG_ROLE),
        (replace(OLD, version=0x0000FFFF), OLDER),
        (replace(OLD, version=0x00010000), OK),
        (replace(OLD, magic=0x4D494646), NONE),
        (replace(OLD, length=0), NONE),
        (replace(OLD, length=4), NONE),
        (replace(OLD, length=19), NONE),
        (replace(OLD, length=4 * (WORDS - CODE) + 4), NONE),
        (replace(OLD, length=ONES - 3), NONE),
    ],
)
def test_each_thing_that_is_wrong_has_its_status(core, image, status):
    node = Node(core)
    node.put(image, 0)
    assert node.check(0, SENSOR, 0x00010000) == status


def test_an_image_as_long_as_the_slot_passes(core):
    node = Node(core)
    node.put(replace(OLD, code=tuple(range(WORDS - CODE))), 1)
    assert node.check(1) == OK


def test_an_image_of_a_stack_pointer_and_an_entry_alone_passes(core):
    node = Node(core)
    node.put(replace(OLD, code=(0x20002000, 0x08020201)), 0)
    assert node.check(0) == OK
    assert node.intact(0)


@pytest.mark.parametrize("words", [0, HEADER, CODE - 1, CODE, CODE + 1])
def test_a_slot_without_room_for_code_holds_no_image_whatever_lies_behind_it(core, words):
    node = Node(core)
    node.put(OLD, 0)
    assert node.check(0) == OK
    node.flash.words = words
    assert node.check(0) == NONE
    assert not node.intact(0)


def test_an_image_is_intact_only_for_its_board_and_only_if_it_is_there(core):
    """A confirmed image is started for this alone, with no look at its signature."""
    node = Node(core)
    assert not node.intact(0)
    node.put(OLD, 0)
    assert node.intact(0)
    node.put(replace(OLD, board=2), 0)
    assert not node.intact(0)
    node.put(replace(OLD, magic=0x4D494646), 0)
    assert not node.intact(0)
    node.confirmed(replace(OLD, board=2), 0, 8)
    node.confirmed(OLD, 1, 7)
    assert node.boot() == Choice(1, False)


def test_the_image_for_the_other_slot_is_refused(core):
    node = Node(core)
    node.cells.read[1][0:WORDS] = OLD.at(0).words()
    assert node.check(1) == WRONG_PLACE
    assert not node.intact(1)


def test_the_signature_of_somebody_else_is_refused_and_without_a_key_any(core):
    node = Node(core)
    node.put(OLD, 0, OTHER_KEY)
    assert node.check(0) == UNSIGNED
    assert node.intact(0)
    node.put(OLD, 0)
    assert Node(core, key=public(OTHER_KEY)).check(0) == NONE
    node.forget_key()
    assert node.check(0) == NO_KEY


@given(noise=st.data())
def test_any_contents_are_survived_and_refused(core, noise):
    """Headers made of chance and of what belongs there: nothing passes that was not signed."""
    node = Node(core)
    words = Image().words()
    values = st.one_of(st.integers(0, ONES), st.sampled_from([0, ONES, 4, 8, 0x4D494647, 0x08020000]))
    places = noise.draw(st.lists(st.integers(SIGNATURE, CODE + 4), min_size=1, max_size=40))
    changed = list(words)
    for place in places:
        changed[place] = noise.draw(values)
    node.cells.read[0][0:WORDS] = changed
    covered = [*range(SIGNATURE, CRC + 1), *range(HEADER, CODE + 5)]
    assert (node.check(0) == OK) == all(changed[i] == words[i] for i in covered)
