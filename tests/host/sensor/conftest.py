"""Sessions in virtual time."""

import pytest

from goldfield import site as sites
from goldfield.sensor.session import Session
from tests.host.fake_sensor import SITE
from tests.host.virtual_link import VirtualLink, told_by

ROOM = sites.load(SITE)


@pytest.fixture
def virtual(monkeypatch):
    """Return a function that makes a link in virtual time and a session on it, which tells the time by the link."""

    def make(node=None, **options):
        link = VirtualLink(**options)
        told_by(link, monkeypatch)
        return link, Session(link, "virtual", ROOM, node)

    return make
