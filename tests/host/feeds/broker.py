"""A real MQTT broker, mosquitto, at a free port of this machine, and a subscriber of its own."""

from __future__ import annotations

import getpass
import queue
import shutil
import subprocess
import threading

import pytest
from paho.mqtt.client import Client
from paho.mqtt.enums import CallbackAPIVersion

from tests.host.free_port import free_port

BROKER = shutil.which("mosquitto") or shutil.which("mosquitto", path="/usr/sbin:/usr/local/sbin")
needs_mosquitto = pytest.mark.skipif(BROKER is None, reason="make installs mosquitto, which is not there")
needs_openssl = pytest.mark.skipif(shutil.which("openssl") is None, reason="make installs openssl, which is not there")
NEW_KEY = ("-newkey", "ec", "-pkeyopt", "ec_paramgen_curve:prime256v1", "-nodes")
TIMEOUT_S = 60.0


class Told:
    """What a feed tells the user, with an event for each sentence."""

    def __init__(self):
        self.texts = []
        self._changed = threading.Condition()

    def __call__(self, text):
        with self._changed:
            self.texts.append(text)
            self._changed.notify_all()

    def wait_for(self, end):
        """Wait for a sentence by its end, and return it."""
        with self._changed:
            found = []
            assert self._changed.wait_for(
                lambda: found.extend(t for t in self.texts if t.endswith(end)) or found, TIMEOUT_S
            ), self.texts
        return found[0]


class Broker:
    """A broker that can be ended and started again at the same port.

    Parameters
    ----------
    folder : Path
    users : dict of str to str, optional
        Passwords by user; without them everybody may connect.
    tls : Certificates, optional
        It speaks TLS, with the certificate of ``localhost``.
    wants_certificate : bool
        Whether who connects must have a certificate of the same authority.
    """

    def __init__(self, folder, users=None, tls=None, *, wants_certificate=False):
        self.port = free_port()
        self._process = None
        self._config = folder / "mosquitto.conf"
        lines = [f"listener {self.port} 127.0.0.1", f"user {getpass.getuser()}", "log_dest stderr"]
        if users:
            passwords = folder / "passwords"
            for name, password in users.items():
                create = [] if passwords.exists() else ["-c"]
                subprocess.run(["mosquitto_passwd", *create, "-b", passwords, name, password], check=True)
            lines.append(f"password_file {passwords}")
        else:
            lines.append("allow_anonymous true")
        if tls is not None:
            lines += [f"cafile {tls.authority}", f"certfile {tls.broker}", f"keyfile {tls.broker_key}"]
            lines.append(f"require_certificate {str(wants_certificate).lower()}")
        self._config.write_text("\n".join(lines) + "\n")

    def start(self):
        """Start, and return when it listens."""
        command = [BROKER, "-v", "-c", str(self._config)]
        self._process = subprocess.Popen(command, stderr=subprocess.PIPE, stdout=subprocess.DEVNULL, text=True)
        said = ""
        while "running" not in said:
            said = self._process.stderr.readline()
            assert said, "the broker has ended"

    def end(self):
        """End it at once, as a power cut does."""
        if self._process is not None:
            self._process.kill()
            self._process.communicate()
            self._process = None

    def __enter__(self):
        self.start()
        return self

    def __exit__(self, *_):
        self.end()


class Certificates:
    """An authority of our own, and what it has signed: the broker ``localhost`` and a client.

    Attributes
    ----------
    authority, broker, broker_key, client, client_key : Path
        Files in PEM.
    """

    def __init__(self, folder):
        folder.mkdir()
        self._folder = folder
        self.authority, key = folder / "ca.pem", folder / "ca.key"
        self._openssl("req", "-x509", *NEW_KEY, "-keyout", key, "-out", self.authority, "-subj", "/CN=our authority")
        self.broker, self.broker_key = self._signed("localhost", key)
        self.client, self.client_key = self._signed("ann", key)

    def _signed(self, name, authority_key):
        certificate, key, request, names = (self._folder / f"{name}.{kind}" for kind in ("pem", "key", "csr", "ext"))
        names.write_text(f"subjectAltName=DNS:{name}\n")
        self._openssl("req", "-new", *NEW_KEY, "-keyout", key, "-out", request, "-subj", f"/CN={name}")
        signing = ("-CA", self.authority, "-CAkey", authority_key, "-CAcreateserial", "-extfile", names)
        self._openssl("x509", "-req", "-in", request, *signing, "-out", certificate)
        return certificate, key

    @staticmethod
    def _openssl(*words):
        subprocess.run(["openssl", *map(str, words)], check=True, capture_output=True)


class Subscriber:
    """Gets everything below a topic.

    Parameters
    ----------
    port : int
    topic : str
    user, password : str, optional
    tls : Certificates, optional
        It speaks TLS, as a client of that authority.
    """

    def __init__(self, port, topic, user=None, password=None, tls=None):
        self.messages = queue.Queue()
        subscribed = queue.Queue()
        self._client = Client(CallbackAPIVersion.VERSION2)
        if user is not None:
            self._client.username_pw_set(user, password)
        self._client.on_connect = lambda client, *_: client.subscribe(topic)
        self._client.on_subscribe = lambda *_: subscribed.put(True)
        self._client.on_message = lambda _client, _data, message: self.messages.put(message)
        if tls is not None:
            self._client.tls_set(tls.authority, tls.client, tls.client_key)
        self._client.connect("127.0.0.1" if tls is None else "localhost", port)
        self._client.loop_start()
        subscribed.get(timeout=TIMEOUT_S)

    def next(self):
        """Return the next message as topic, payload and whether it was retained."""
        message = self.messages.get(timeout=TIMEOUT_S)
        return message.topic, message.payload.decode(), message.retain

    def __enter__(self):
        return self

    def __exit__(self, *_):
        self._client.disconnect()
        self._client.loop_stop()
