"""The firmware's judgement of frames against the host's, over every type, index and length that matter."""

from goldfield_protocol.messages import Identifier, Mismatch, mismatch, shapes


def test_the_same_frames_are_messages_as_on_the_host(core):
    _, lib = core
    faults = {None: lib.MESSAGE_OK, Mismatch.FOREIGN: lib.MESSAGE_FOREIGN, Mismatch.LENGTH: lib.MESSAGE_WRONG_LENGTH}
    seen = set()
    for type_ in range(32):
        largest = shapes()[type_].largest_index if type_ in shapes() else 0
        for index in {0, largest, min(largest + 1, 4095), 4095}:
            for length in range(16):  # a CAN controller may tell up to 15
                identifier = Identifier(type_, index, 0xFFF).pack()
                assert lib.message_index(identifier) == index
                fault = lib.message_fault(identifier, length)
                assert fault == faults[mismatch(identifier, length)]
                seen.add(fault)
    assert len(seen) == 3
