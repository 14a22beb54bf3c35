"""A real MQTT broker, mosquitto, at a free port of this machine, and a subscriber of its own."""

from __future__ import annotations

import getpass
import queue
import shutil
import socket
import subprocess

import pytest
from paho.mqtt.client import Client
from paho.mqtt.enums import CallbackAPIVersion

BROKER = shutil.which("mosquitto") or shutil.which("mosquitto", path="/usr/sbin:/usr/local/sbin")
needs_mosquitto = pytest.mark.skipif(BROKER is None, reason="make installs mosquitto, which is not there")
TIMEOUT_S = 60.0


def free_port():
    with socket.socket() as other:
        other.bind(("127.0.0.1", 0))
        return other.getsockname()[1]


class Broker:
    """A broker that can be ended and started again at the same port.

    Parameters
    ----------
    folder : Path
    users : dict of str to str, optional
        Passwords by user; without them everybody may connect.
    """

    def __init__(self, folder, users=None):
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


class Subscriber:
    """Gets everything below a topic.

    Parameters
    ----------
    port : int
    topic : str
    user, password : str, optional
    """

    def __init__(self, port, topic, user=None, password=None):
        self.messages = queue.Queue()
        subscribed = queue.Queue()
        self._client = Client(CallbackAPIVersion.VERSION2)
        if user is not None:
            self._client.username_pw_set(user, password)
        self._client.on_connect = lambda client, *_: client.subscribe(topic)
        self._client.on_subscribe = lambda *_: subscribed.put(True)
        self._client.on_message = lambda _client, _data, message: self.messages.put(message)
        self._client.connect("127.0.0.1", port)
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
