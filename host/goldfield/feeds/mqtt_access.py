"""What an MQTT broker asks of who connects: a password, and TLS with certificates; and why it is not reached, in words.

A password comes from the file that ``?password_file=`` names or from the environment variable
``GOLDFIELD_MQTT_PASSWORD``, so that it stands neither on the command line nor in a message.
"""

from __future__ import annotations

import os
import ssl
from pathlib import Path

from goldfield.errors import UserError
from goldfield.feeds.address import Address
from goldfield.files.inputs import reason_of

PASSWORD = "GOLDFIELD_MQTT_PASSWORD"
LONGEST_PASSWORD = 65535
"""Bytes of a password that MQTT has room for."""


def password_of(address: Address) -> str | None:
    """Return the password of the user that an address names; None if there is none.

    The end of the line behind it in a file is no part of it.

    Raises
    ------
    UserError
        If the file cannot be read or holds none.
    """
    path = address.options.get("password_file")
    if path is None:
        return os.environ.get(PASSWORD)
    if address.user is None:
        raise address.wrong(f"password_file needs a user, as {address.scheme}://ann@{address.host}/{address.path}")
    try:
        with Path(path).open(encoding="utf-8") as file:
            password = file.read(LONGEST_PASSWORD + 2).removesuffix("\n")
    except (OSError, ValueError) as error:  # ValueError: no UTF-8, or a zero byte in the path
        raise address.wrong(f"password_file={path} cannot be read: {reason_of(error)}") from None
    if not password or len(password.encode()) > LONGEST_PASSWORD:
        raise address.wrong(f"password_file={path} holds no password: write it there, as the only line")
    return password


def tls_of(address: Address) -> ssl.SSLContext:
    """Return how to speak TLS with a broker: its certificate must be of an authority that is trusted, for this host.

    ``?ca=`` names the file of the authorities, in place of the system's; ``?cert=`` and ``?key=`` a certificate of this
    program and its key, for brokers that ask for one.

    Raises
    ------
    UserError
        If one of the files cannot be read or is not what it should be.
    """
    context = ssl.SSLContext(ssl.PROTOCOL_TLS_CLIENT)
    authorities, own, key = (address.options.get(name) for name in ("ca", "cert", "key"))
    if authorities is None:
        context.load_default_certs()
    else:
        try:
            context.load_verify_locations(authorities)
        except (OSError, ValueError) as error:
            raise _unusable(address, f"ca={authorities} is no file of certificates in PEM", error) from None
    if own is not None:
        try:
            context.load_cert_chain(own, key, password="")  # else OpenSSL would ask for one at the terminal
        except (OSError, ValueError) as error:
            files = f"cert={own}" if key is None else f"cert={own} with key={key}"
            raise _unusable(address, f"{files} is no certificate with its key in PEM, unencrypted", error) from None
    elif key is not None:
        raise address.wrong(f"key={key} needs the certificate that it belongs to, as cert=FILE")
    return context


def why_not_reached(address: Address, error: BaseException | None) -> str:
    """Return why a broker was not reached, as a sentence; None is an error of which nothing is known."""
    if isinstance(error, ssl.SSLCertVerificationError):
        said = error.verify_message.rstrip(".")
        advice = ": use a name that its certificate has" if "mismatch" in said else ""
        advice = advice or (": name its authority's file as ca=FILE" if "issuer" in said or "self" in said else "")
        return f"the broker's certificate is not trusted ({said}){advice}"
    if address.scheme == "mqtts" and isinstance(error, (ssl.SSLEOFError, ConnectionResetError, BrokenPipeError)):
        return "what is there ends the connection: it may speak no TLS, as mqtt://"
    if isinstance(error, ssl.SSLError):
        return f"no TLS can be spoken with what is there ({_reason(error)})"
    return "no broker answers there" if error is None else f"no broker answers there: {reason_of(error)}"


def why_turned_away(address: Address) -> str:
    """Return what to say of a broker that ends a connection before it has welcomed or refused it."""
    if address.scheme == "mqtt":
        return "the broker ends the connection at once: it may want TLS, as mqtts://"
    if "cert" not in address.options:
        return "the broker ends the connection at once: it may want a certificate of yours, as cert=FILE&key=FILE"
    return "the broker ends the connection at once: it may not trust your certificate"


def _unusable(address: Address, what: str, error: OSError | ValueError) -> UserError:
    return address.wrong(f"{what}: {_reason(error) if isinstance(error, ssl.SSLError) else reason_of(error)}")


def _reason(error: ssl.SSLError) -> str:
    """Return what OpenSSL says of an error, in small letters; it has no words for some."""
    return (error.reason or "nothing more is known").replace("_", " ").lower()
