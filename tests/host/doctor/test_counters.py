"""What the doctor makes of counters that grow while it looks."""

import pytest

from goldfield import site as sites
from goldfield.doctor.checks import Fault
from goldfield.doctor.examination import Examination
from goldfield.nodes.roster import Node, Roster
from tests.host.fake_sensor import SITE


@pytest.mark.parametrize(
    ("index", "grown", "fault", "text"),
    [
        (10, 0, None, ""),
        (10, 5, Fault.LINK, "node 3 counted 5 sync edges rejected in these seconds"),
        (10, 6, Fault.MASTERS, "node 3 found 6 edges of the sync wire at wrong times"),
        (2, 1, Fault.LINK, "node 3 counted 1 CAN error in these seconds"),
    ],
)
def test_counters_that_grow_are_told(index, grown, fault, text):
    roster = Roster()
    roster.nodes[3] = Node(3, 0.0, 1.0, role="beacon", counters={index: 40 + grown})
    examination = Examination("port", "/dev/null", sites.load(SITE), None)
    checks = list(examination._of_counters(roster, {3: {index: 40}}))
    assert [(check.fault, check.text) for check in checks] == ([(fault, text)] if fault else [])
