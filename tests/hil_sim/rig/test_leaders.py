"""Who drives the sync wire runs ahead of the boards that hear it, whoever it was before: none hears an edge late."""

from goldfield_protocol import decode
from goldfield_protocol.table import counter_name
from hil_sim.rig import Rig
from hil_sim.scenario import load_scenario
from tests.bench.takeover_figures import scenario

MASTER = 1
DEPUTIES = range(2, 6)
SETTLED_S = 3.0
"""Time in which boards start, find who leads, and lock."""


def test_a_master_that_begins_a_time_of_its_own_behind_a_deputy_is_heard_in_time(tmp_path):
    """Its first edge comes before its first SYNC. All later ones were heard up to 20 us late, by all boards.

    The first one may still be late for deputies, which then search anew. The sensor, which goes on, has to do so.
    """
    rejected, locked = {}, {}
    with Rig(load_scenario(str(scenario(tmp_path, "wire"))), "host") as rig:
        rig.advance(SETTLED_S)
        rig.power_cycle(MASTER, 1.0)
        rig.advance(SETTLED_S)
        for board in range(1, 1 + len(rig.scenario.beacons)):
            rig.power_cycle(board, 0.05)
        rig.can_read()
        rig.advance(SETTLED_S)
        frames = rig.can_read()
        leaders = set()
        for frame in frames:
            message = decode(frame.identifier, frame.data)
            if message.name == "COUNTER" and counter_name(message.index) == "sync edges rejected":
                rejected[message.node] = message.signals["value"]
            elif message.name == "DRIVE_STATUS":
                locked[message.node] = message.signals["locked"]
            elif message.name == "SYNC":
                leaders.add(message.node)
    nodes = [beacon.node for beacon in rig.scenario.beacons]
    assert leaders == {nodes[MASTER - 1]}
    assert locked == dict.fromkeys(nodes, 1.0)
    assert not rejected.keys() & set(nodes[max(DEPUTIES) :])
    assert all(rejected.get(nodes[board - 1], 0.0) <= 3.0 for board in DEPUTIES)
