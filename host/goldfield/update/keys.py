"""The key pair of a site: who holds the private key can make images that its boards take.

A private key is kept in a file of its own, readable by its owner alone and never overwritten: boards that know its
public key take no image that another one has signed, until a probe writes them anew. The signature is Ed25519 (RFC
8032).
"""

from __future__ import annotations

import errno
import os
import stat
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING

from goldfield.errors import SystemFailure, UserError
from goldfield.files.inputs import read_bounded, reason_of
from goldfield_protocol.image import KEY_BYTES

if TYPE_CHECKING:
    from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey

MODE = 0o600
MOST_BYTES = 4096
"""More than any file of a key has."""
KIND = "private key"


def make(path: str, passphrase: bytes | None = None) -> bytes:
    """Make a key pair, keep the private key in a new file, and return the public key, `KEY_BYTES` bytes.

    The file is there whole or not at all, with the mode `MODE` from its first byte on.

    Raises
    ------
    UserError
        There is such a file, or it cannot be made there.
    SystemFailure
        The disk is full or broken; nothing is left of the file then.
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
    _keep(path, key.private_bytes(Encoding.PEM, PrivateFormat.PKCS8, encryption))
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

    data = read_bounded(path, KIND, MOST_BYTES)
    with suppress(OSError):  # stdin, which is -
        status = Path(path).stat()
        if stat.S_ISREG(status.st_mode) and stat.S_IMODE(status.st_mode) & 0o077:
            raise UserError(f"{path}: others may read or write this private key: chmod 600 {path}")
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


def _keep(path: str, data: bytes) -> None:
    """Write a new file that nobody else may read; an older one of this name is never replaced."""
    try:
        place = Path(path).absolute()
        beside = place.with_name(f".{place.name[:200]}.{os.getpid()}.part")
        descriptor = os.open(beside, os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_CLOEXEC, MODE)
    except (OSError, ValueError) as error:  # a zero byte in the path
        raise UserError(f"{path}: the {KIND} cannot be written: {reason_of(error)}") from error
    try:
        with os.fdopen(descriptor, "wb") as file:
            os.fchmod(file.fileno(), MODE)
            file.write(data)
            file.flush()
            os.fsync(file.fileno())
        os.link(beside, place)  # Unlike a rename it fails if there is such a file.
        _sync_directory(place.parent)
    except FileExistsError:
        raise UserError(
            f"{path}: exists, and a key is never overwritten, as its boards take no other: give a new file"
        ) from None
    except OSError as error:
        raise SystemFailure(f"{path}: the {KIND} cannot be written: {reason_of(error)}") from error
    finally:
        beside.unlink(missing_ok=True)


def _sync_directory(directory: Path) -> None:
    descriptor = os.open(directory, os.O_RDONLY | os.O_DIRECTORY | os.O_CLOEXEC)
    try:
        os.fsync(descriptor)
    except OSError as error:
        if error.errno not in (errno.EINVAL, errno.EROFS):  # a file system without such a thing
            raise
    finally:
        os.close(descriptor)
