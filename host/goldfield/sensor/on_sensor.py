"""Poses that the sensor itself computed: what it must know for them, and its messages as `Pose`."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from goldfield.access.waveform import site_templates
from goldfield.field import FieldModel
from goldfield.link.reports import CYCLE_MODULUS, LOW_MODULUS, ON_SENSOR_POSE, Report
from goldfield.site import Beacon, Site
from goldfield.types import Explanation, Fields, Finding, Pose, Status
from goldfield_protocol.messages import Message
from goldfield_protocol.parameters import PARAMETERS

STATUS = (Status.OK, Status.AMBIGUOUS, Status.WEAK, Status.INCONSISTENT, Status.FAILED, Status.UNVERIFIED)
"""The statuses, in the order of their numbers in ``POSE_QUALITY``."""

MIRRORED = (
    "the negated fields fit: the sensor's axes are left-handed or all coils are reversed; check the wiring of x, y, z"
)

FINDINGS = {
    4: (Explanation.MIRRORED, MIRRORED),
    12: (
        Explanation.STRENGTH,
        "fields of another strength fit: check the sensor's calibration and the currents of all beacons",
    ),
    13: (
        Explanation.AXIS_GAIN,
        "other gains of the sensor's axes fit: check the sensor's calibration, axis by axis",
    ),
}
"""What explains the fields with all beacons, by the number of the reason in ``POSE_INTEGRITY``."""

REASONS = {
    1: "fewer than three beacons are heard",
    2: "the fields are nothing but noise",
    3: "the fields do not fix a pose",
    5: "one beacon is not as the site says, and it is not clear which",
    6: "no single beacon explains why the fields do not fit",
    7: "the pose is outside the half-space of the site",
    8: "another pose fits the fields as well",
    9: "the beacons that are heard do not fix the pose",
    10: "a fault of one beacon could hide an error above the alert limit",
    14: "the fields do not agree with the site, and the sensor is still computing what is wrong",
    15: "the sensor had no time to compute a pose",
    **{number: text for number, (_, text) in FINDINGS.items()},
}
"""Sentences for the other numbers of ``POSE_INTEGRITY.reason``; 0 says nothing, and 11 names a beacon."""

NOT_LEFT_OUT = 255
"""Value of ``POSE_INTEGRITY.left_out`` if no beacon was left out."""

CLOCK_TOLERANCE = 1e-3
"""Largest difference, relative, of a cycle on the sensor's clock from the nominal one that is believed."""

NO_PROMISE_M = 1048.575
"""Largest value of ``POSE_INTEGRITY.protection``: nothing is promised."""


def reason_of(integrity: Mapping[str, float], names: tuple[str, ...]) -> str | None:
    """Return the sentence that a ``POSE_INTEGRITY`` message stands for; None if there is nothing to say.

    Parameters
    ----------
    integrity : mapping of str to float
        Signals of the message.
    names : tuple of str
        Ids of the site's beacons, in the order of the sensor's table.

    Examples
    --------
    >>> reason_of({"reason": 11.0, "left_out": 1.0}, ("b1", "b2"))
    'b2 does not agree with the site and was left out'
    >>> reason_of({"reason": 0.0, "left_out": 255.0}, ("b1", "b2")) is None
    True
    """
    left_out = _left_out(integrity, names)
    sentence = REASONS.get(int(integrity["reason"]))
    blamed = " and ".join(f"{name} does not agree with the site and was left out" for name in left_out)
    return "; ".join(part for part in (sentence, blamed) if part) or None


def _left_out(integrity: Mapping[str, float], names: tuple[str, ...]) -> tuple[str, ...]:
    row = int(integrity["left_out"])
    return (names[row],) if row != NOT_LEFT_OUT and row < len(names) else ()


def on_sensor_parameters(site: Site, pose_blocks: int = 0) -> Mapping[int, int | float]:
    """Return the parameters, by id, with which a sensor computes its pose on a site whose codes it reports.

    With ``pose_blocks`` it also follows its own motion, and tells a pose after every so many blocks of 31 chips.

    A coil given by its wire becomes the circle of its area, which is its field from a few diameters on. A coil that
    follows its code slowly becomes as much weaker as its part in the correlation is, so that the sensor need not know
    ``tau_s``; what it adds to the correlations with other codes, .2 % of it at .3 chips, stays.
    """
    model = FieldModel(site.beacons)
    ideal, risen = (np.asarray(site_templates(site, rise)) for rise in (False, True))
    gain = (ideal * (risen - risen.mean(axis=0))).sum(axis=0) / (ideal * (ideal - ideal.mean(axis=0))).sum(axis=0)
    rows: list[float] = []
    for beacon, centre, moment, part in zip(site.beacons, model.centre_m, model.moment_A_m2, gain, strict=True):
        size = float(np.linalg.norm(moment))
        area = size / abs(beacon.turns * beacon.current_A)
        rows += [*centre.tolist(), *(moment / size).tolist(), float(part) * size, float(np.sqrt(area / np.pi))]
    half = np.zeros(6)
    if site.half_space is not None:
        half = np.concatenate([site.half_space.point_m, site.half_space.normal])
    values: dict[str, list[int | float]] = {
        "noise": [float(site.sensor.noise_T)],
        "alert_limit": [float(site.alert_limit_m)],
        "half_space": half.tolist(),
        "beacons": list(rows),
        "survey": [deviation for beacon in site.beacons for deviation in _deviations(beacon)],
        "gain_sd": [site.sensor.gain_sd],
        "axis_sd": [site.sensor.axis_sd_rad],
        "pose": [1],
        "pose_blocks": [pose_blocks],
    }
    return {
        PARAMETERS[name].identifier(element): value
        for name, elements in values.items()
        for element, value in enumerate(elements)
    }


def _deviations(beacon: Beacon) -> tuple[float, float, float]:
    return beacon.survey.position_sd_m, beacon.survey.axis_sd_rad, beacon.survey.current_sd


def on_sensor_pose(site: Site, report: Report, fields: Fields) -> Pose:
    """Return the pose that came with a report; failed if some of its messages did not.

    The messages tell only the sum of the variances of position and that of attitude: each is shared out evenly over its
    three axes.

    Parameters
    ----------
    site : Site
    report : Report
    fields : Fields
        The fields of the same epoch.
    """
    if len(report.on_sensor_pose) < len(ON_SENSOR_POSE):
        return Pose.failed(fields, excluded=fields.beacons, reason="messages of the sensor's pose were lost")
    return _pose_of(site, report.on_sensor_pose, fields)


def _pose_of(site: Site, messages: Mapping[str, Mapping[str, float]], fields: Fields) -> Pose:
    """Return the pose that the four messages tell, with the epoch, time and beacons of ``fields``."""
    position, attitude, quality, integrity = (messages[name] for name in ON_SENSOR_POSE)
    names = tuple(beacon.id for beacon in site.beacons)
    number, sentence = int(quality["status"]), reason_of(integrity, names)
    status = STATUS[number] if number < len(STATUS) else Status.FAILED
    quaternion = np.array([attitude[axis] for axis in "xyzw"])
    size = float(np.linalg.norm(quaternion))
    if status is Status.FAILED or size < 0.5:
        return Pose.failed(fields, excluded=fields.beacons, reason=sentence or "the sensor found no pose")
    excluded = _left_out(integrity, names)
    rest = tuple(name for name in names if name not in excluded)
    used = int(quality["used"])
    protection_m = float(integrity["protection"])
    finding = FINDINGS.get(int(integrity["reason"]))
    return Pose(
        epoch=fields.epoch,
        time_s=fields.time_s,
        position_m=np.array([position[axis] for axis in "xyz"]),
        orientation_xyzw=quaternion / size,
        position_cov_m2=np.eye(3) * quality["sigma_position"] ** 2 / 3.0,
        attitude_cov_rad2=np.eye(3) * quality["sigma_attitude"] ** 2 / 3.0,
        residual=quality["residual"],
        status=status,
        used=rest if used == len(rest) else ("?",) * used,  # it tells how many, not which
        excluded=excluded,
        reason=sentence,
        protection_m=protection_m if protection_m < NO_PROMISE_M - 1e-6 else np.inf,
        findings=() if finding is None else (Finding(finding[0], (), finding[1]),),
    )


class OnSensorTrack:
    """Poses that a sensor tells at the ends of blocks (parameter ``pose_blocks``), put together from its messages.

    A pose is stamped with the end of its block, on the sensor's clock: by the number and the time of the latest
    ``EPOCH``, and the chip that the index of its messages tells. Poses before the first ``EPOCH`` are left out.

    Parameters
    ----------
    site : Site

    Attributes
    ----------
    lost : int
        Poses of which some messages are missing.
    """

    def __init__(self, site: Site) -> None:
        self.lost = 0
        self._site = site
        self._cycle_s = site.cycle_s
        self._epoch: tuple[int, float] | None = None
        self._block = 0, 0
        self._messages: dict[str, Mapping[str, float]] = {}

    def feed(self, message: Message) -> Pose | None:
        """Return the pose that this message completes, if it does; others than those of blocks' poses are ignored.

        Parameters
        ----------
        message : Message
            Every message of the sensor, in order of arrival.

        Returns
        -------
        Pose or None
            With the number of the cycle of the block's last chip as ``epoch``.
        """
        if message.name == "EPOCH":
            self._begin_cycle(int(message.signals["cycle"]), message.signals["time"])
        if message.name not in ON_SENSOR_POSE or not 1 <= message.index <= self._site.chips:
            return None
        block = message.index, int(message.signals["cycle_low"])
        if block != self._block or message.name in self._messages:
            self.lost += bool(self._messages)
            self._messages.clear()
        self._block = block
        self._messages[message.name] = message.signals
        if len(self._messages) < len(ON_SENSOR_POSE):
            return None
        messages, self._messages = self._messages, {}
        return self._stamped(messages)

    def _begin_cycle(self, cycle: int, time_s: float) -> None:
        if self._epoch is not None and cycle == (self._epoch[0] + 1) % CYCLE_MODULUS:
            length_s = time_s - self._epoch[1]
            if abs(length_s / self._site.cycle_s - 1.0) < CLOCK_TOLERANCE:
                self._cycle_s = length_s
        self._epoch = cycle, time_s

    def _stamped(self, messages: Mapping[str, Mapping[str, float]]) -> Pose | None:
        if self._epoch is None:
            return None
        cycle, middle_s = self._epoch
        (index, low), half = self._block, LOW_MODULUS // 2
        ahead = (low - cycle + half) % LOW_MODULUS - half
        time_s = middle_s + self._cycle_s * (ahead + index / self._site.chips - 0.5)
        names = tuple(beacon.id for beacon in self._site.beacons)
        unknown = np.full(len(names), np.nan)
        fields = Fields((cycle + ahead) % CYCLE_MODULUS, time_s, names, np.full((len(names), 3), np.nan), unknown)
        return _pose_of(self._site, messages, fields)
