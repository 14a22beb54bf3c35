"""The table of fields on a disk that fills up."""

import resource
import signal
from contextlib import contextmanager

import numpy as np
import pytest

from goldfield import Fields, SystemFailure, load_site, read_fields
from goldfield.sensor.fields_table import FieldsWriter
from goldfield.sensor.sinks import Fanout
from tests.host.fake_sensor import SITE


@contextmanager
def small_disk():
    """A limit of the size of files, which acts as a full disk does: a write is cut short, the next refused.

    It holds for what pytest writes, too, and so not for longer than it has to.
    """
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    handler = signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
    resource.setrlimit(resource.RLIMIT_FSIZE, (1000, before[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)
        signal.signal(signal.SIGXFSZ, handler)


def epoch(number):
    site = load_site(SITE)
    ids = tuple(beacon.id for beacon in site.beacons)
    return Fields(number, 0.1 * number, ids, np.full((len(ids), 3), 1.25e-7), np.full(len(ids), 1e-9))


def test_whole_epochs_are_left_and_it_is_told_once(tmp_path, capsys):
    path = tmp_path / "fields.csv"
    with small_disk(), Fanout(waits=True) as sinks:
        sinks.add(FieldsWriter(path), str(path))
        for number in range(1, 9):
            sinks.write(epoch(number))
    err = capsys.readouterr().err
    kept = [fields.epoch for fields in read_fields(load_site(SITE), path)]
    assert kept == list(range(1, len(kept) + 1))
    assert len(kept) >= 2
    assert path.read_text().count("\n") == 1 + 8 * len(kept)
    assert err == f"goldfield: {path}: the fields cannot be written: No space left on device; the run goes on without\n"


def test_a_table_that_cannot_be_begun_is_refused():
    with pytest.raises(SystemFailure, match=r"^/dev/full: the fields cannot be written: No space left on device$"):
        FieldsWriter("/dev/full")
