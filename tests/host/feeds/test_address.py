"""Where feeds go: what each URL means, and that one which means nothing is refused with the option's name."""

import pytest

from goldfield.cli import main
from goldfield.errors import UserError, on_command_line
from goldfield.feeds.address import EXAMPLES, parse_address
from goldfield.feeds.opening import MODULES


@pytest.mark.parametrize(
    ("url", "scheme", "host", "port", "path"),
    [
        ("ws:", "ws", "127.0.0.1", 8421, ""),
        ("ws://:9", "ws", "127.0.0.1", 9, ""),
        ("ws://0.0.0.0:0", "ws", "0.0.0.0", 0, ""),
        ("ws://[::1]:9/", "ws", "::1", 9, ""),
        ("foxglove:", "foxglove", "127.0.0.1", 8765, ""),
        ("udp://239.1.2.3:9000", "udp", "239.1.2.3", 9000, ""),
        ("mqtt://broker/hall/pose", "mqtt", "broker", 1883, "hall/pose"),
        ("mqtt://ann@broker:1/x", "mqtt", "broker", 1, "x"),
        ("mqtts://ann@broker/x", "mqtts", "broker", 8883, "x"),
        ("mqtt://[fe80::1%eth0]/x", "mqtt", "fe80::1%eth0", 1883, "x"),
        ("mqtt://[::1]:9/x", "mqtt", "::1", 9, "x"),
        ("ros2:goldfield", "ros2", "", 0, "goldfield"),
        ("ros2:/robot/goldfield?tf=no", "ros2", "", 0, "robot/goldfield"),
        ("tum:a b?c#d.txt", "tum", "", 0, "a b?c#d.txt"),
        ("nmea:-", "nmea", "", 0, "-"),
        ("nmea+udp://h:1", "nmea+udp", "h", 1, ""),
    ],
)
def test_what_a_url_means(url, scheme, host, port, path):
    address = parse_address(url)
    assert (address.scheme, address.host, address.port, address.path) == (scheme, host, port, path)


def test_the_user_and_the_options_of_a_url():
    assert parse_address("mqtt://ann@broker/x").user == "ann"
    assert parse_address("ros2:a?map=world&tf=no").options == {"map": "world", "tf": "no"}
    assert parse_address("mqtts://b/x?ca=a+b%26c.pem").options == {"ca": "a+b&c.pem"}


@pytest.mark.parametrize(
    ("url", "said"),
    [
        ("", "is no feed: give one as foxglove:"),
        ("ws", "is no feed"),
        ("tcp://h:1", "is no feed"),
        ("ws://h:x", "is no address"),
        ("ws://h:65536", "is no address"),
        ("ws://[::1", "is no address"),
        ("ws://h:1/path", "has more than address and port"),
        ("ws://ann@h:1", "has more than address and port"),
        ("ws://h:1?token=x", "'token' is none of its options (origin)"),
        ("ws:?origin=localhost:3000", "'localhost:3000' is no origin: give it as http://localhost:3000"),
        ("ws:?origin=http://localhost:3000/", "'http://localhost:3000/' is no origin"),
        ("ws:?origin=http://a.example,x", "'x' is no origin"),
        ("mqtt://h/hall/#", "'#' has no meaning here"),
        ("udp://h", "needs a port"),
        ("udp://h:0", "needs a port"),
        ("udp://:9", "needs a host"),
        ("mqtt:///x", "needs a host"),
        ("mqtt://h", "needs a topic"),
        ("mqtt://h/", "needs a topic"),
        ("mqtt://h/a/+", "needs a topic without + and #"),
        ("mqtt://h/x#y", "'#y' has no meaning here"),
        ("mqtt://h/x?qos=2", "'qos' is none of its options (password_file)"),
        ("mqtt://h/x?ca=c.pem", "'ca' is none of its options (password_file)"),
        ("udp://h:9?ttl=2", "'ttl' is none of its options (none)"),
        ("mqtt://a..b/x", "'a..b' is no name of a host"),
        (f"udp://{'a' * 64}:9", "is no name of a host"),
        ("ros2:", "needs the beginning of its topics"),
        ("ros2://h/x", "needs the beginning of its topics"),
        ("ros2:a-b", "needs the beginning of its topics"),
        ("ros2:1a", "needs the beginning of its topics"),
        ("tum:", "needs a file"),
        ("tum://x", "needs a file"),
        ("nmea+udp://h", "needs a port"),
    ],
)
def test_a_url_that_means_nothing_is_refused(url, said):
    with on_command_line(), pytest.raises(UserError) as raised:
        parse_address(url)
    assert str(raised.value).startswith(f"--feed {url}".rstrip() + ": ")
    assert said in str(raised.value)


def test_a_password_is_refused_and_not_repeated():
    with pytest.raises(UserError, match="would see the password") as raised:
        parse_address("mqtt://ann:secret@broker/x")
    assert "secret" not in str(raised.value)


def test_every_scheme_has_an_example_that_is_read_and_a_module():
    assert {parse_address(example).scheme for example in EXAMPLES.values()} == set(EXAMPLES) == set(MODULES)


def test_the_command_refuses_a_feed_before_it_looks_for_a_sensor(capsys):
    assert main(["run", "--port", "/dev/no-such-port", "--site", "no.toml", "--feed", "ws:", "--feed", "tcp://x"]) == 2
    assert capsys.readouterr().err.startswith("goldfield: --feed tcp://x: is no feed")
