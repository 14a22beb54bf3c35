"""The key pair of a site: who holds the private key can make images that its boards take.

A private key is kept in a file of its own, readable by its owner alone and never overwritten: boards that know its
public key take no image that another one has signed, until a probe writes them anew. The signature is Ed25519 (RFC
8032).
"""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING

from goldfield.errors import UserError
from goldfield.files import secret_file
from goldfield_protocol.image import KEY_BYTES

if TYPE_CHECKING:
    from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey

MOST_BYTES = 4096
"""More than any file of a key has."""
KIND = "private key"


def make(path: str, passphrase: bytes | None = None) -> bytes:
    """Make a key pair, keep the private key in a new file, and return the public key, `KEY_BYTES` bytes.

    The errors are those of `goldfield.files.secret_file.keep`.
    """
    from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey
    from cryptography.hazmat.primitives.serialization import (
        BestAvailableEncryption,
        Encoding,
        NoEncryption,
        PrivateFormat,
    )

    key = Ed25519PrivateKey.generate()
    encryption = BestAvailableEncryption(passphrase) if passphrase else NoEncryption()
    secret_file.keep(path, key.private_bytes(Encoding.PEM, PrivateFormat.PKCS8, encryption), KIND)
    return public_bytes(key)


def load(path: str, passphrase: Callable[[], bytes]) -> Ed25519PrivateKey:
    """Return the private key of a file.

    Parameters
    ----------
    path : str
    passphrase : callable
        It is asked for the passphrase if the key has one.

    Raises
    ------
    UserError
        The file is not there, others may read or write it, or it holds no such key; or the passphrase is wrong.
    """
    from cryptography.exceptions import UnsupportedAlgorithm
    from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey
    from cryptography.hazmat.primitives.serialization import load_pem_private_key

    data = secret_file.read(path, KIND, MOST_BYTES)
    given = passphrase() if b"ENCRYPTED" in data else None
    try:
        key = load_pem_private_key(data, given)
    except (ValueError, TypeError, UnsupportedAlgorithm) as error:
        if given is not None:
            raise UserError(f"{path}: the passphrase is wrong, or the file is damaged: try again") from error
        raise UserError(f"{path}: holds no {KIND}: give a file that goldfield keys make has made") from error
    if not isinstance(key, Ed25519PrivateKey):
        raise UserError(f"{path}: holds a key of another kind than Ed25519: give one that goldfield keys make has made")
    return key


def public_bytes(key: Ed25519PrivateKey) -> bytes:
    """Return the public key that belongs to a private one."""
    from cryptography.hazmat.primitives.serialization import Encoding, PublicFormat

    return key.public_key().public_bytes(Encoding.Raw, PublicFormat.Raw)


def public_of(text: str) -> bytes:
    """Return the public key that a text of hexadecimal digits tells; `UserError` if it is none.

    Examples
    --------
    >>> public_of("ab" * 32)[:2].hex()
    'abab'
    """
    try:
        key = bytes.fromhex(text)
    except ValueError:
        key = b""
    if len(key) != KEY_BYTES:
        raise UserError(
            f"{text!r} is no public key: give its {2 * KEY_BYTES} hexadecimal digits, which goldfield keys show prints"
        )
    return key


def has_signed(public: bytes, signature: bytes, message: bytes) -> bool:
    """Tell whether the owner of a public key has signed a message."""
    from cryptography.exceptions import InvalidSignature
    from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PublicKey

    try:
        Ed25519PublicKey.from_public_bytes(public).verify(signature, message)
    except InvalidSignature:
        return False
    return True
