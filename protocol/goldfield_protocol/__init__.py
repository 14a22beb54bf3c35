"""Every message on the wire, once: identifiers, packing, serial framing and code generation.

The messages are defined in ``goldfield.dbc`` and nowhere else. See ``framing.md`` for the
identifiers, the serial frames and the protocol hash.
"""

from goldfield_protocol.framing import FrameDecoder, RawFrame, encode_frame
from goldfield_protocol.messages import (
    DBC,
    Identifier,
    Message,
    database,
    decode,
    encode,
    protocol_hash,
)

__all__ = [
    "DBC",
    "FrameDecoder",
    "Identifier",
    "Message",
    "RawFrame",
    "database",
    "decode",
    "encode",
    "encode_frame",
    "protocol_hash",
]
