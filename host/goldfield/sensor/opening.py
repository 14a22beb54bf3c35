"""The doors: a sensor on a port or a bus, and a recording, opened as a `Sensor`."""

from __future__ import annotations

from pathlib import Path

from goldfield.errors import UserError, option
from goldfield.link.access_key import load_key
from goldfield.link.buses import Source
from goldfield.sensor.options import Options, chosen_method
from goldfield.sensor.pipeline import Sensor, rehearse
from goldfield.sensor.receiver import Recorder
from goldfield.sensor.sources import open_source
from goldfield.site import Site, load


def connect(
    *,
    port: str | Path | None = None,
    can: str | None = None,
    site: Site | str | Path,
    node: int | None = None,
    track: bool = False,
    on_sensor: bool = False,
    listen_only: bool = False,
    reconnect: bool = False,
    rate_hz: float | None = None,
    lag_s: float | None = None,
    strongest: int | None = None,
    key: str | Path | None = None,
    bit_rate: int | None = None,
) -> Sensor:
    """Connect to a sensor board: find it, check that it suits the site, and make it report the site's beacons.

    Parameters
    ----------
    port, can : path or str, optional
        Serial port of the sensor, or interface and channel of python-can, as ``"socketcan:can0"``: exactly one.
    site, node : Site or path, and int, optional
        The site, or its file; node of the sensor, 1 to 4095, where there are several, or it is an anchor's.
    track, on_sensor : bool, optional
        Follow a sensor in motion, each pose that of its cycle's end, or let the sensor board compute the poses; else
        every epoch is located by itself, as of the middle of its cycle.
    listen_only, reconnect : bool, optional
        Send nothing, ever, as where another host has set up the sensor; wait for a port that is gone and a sensor that
        is silent, at the start, too, where they else end the poses.
    rate_hz, lag_s : float, optional
        Track; yield so many poses a second, each as soon as its block of chips (330 a second), or with ``on_sensor``
        the sensor's own, is there; yield them so much later, made of what came behind them, too.
    strongest, key, bit_rate : int, path and int, optional
        Report the codes heard best, so many (up to 64); file of a locked sensor's key; bits a second (else found).

    Returns
    -------
    Sensor
        Its `Sensor.poses` yields ten poses a second, unless a rate is asked for.

    Raises
    ------
    UserError
        If arguments, link or site file are wrong, or the sensor is not the only one, or suits neither host nor site.
    SystemFailure
        If no sensor is heard within 10 s (30 s if others are), or it does not answer, unless it is waited for.

    Examples
    --------
    >>> import goldfield
    >>> with goldfield.connect(port="/dev/ttyUSB0", site="room.toml") as sensor:  # doctest: +SKIP
    ...     pose = next(sensor.poses())
    >>> goldfield.connect(site="room.toml")
    Traceback (most recent call last):
    goldfield.errors.UserError: no source is given: give one of port= and can=
    """
    method = chosen_method(track, on_sensor, rate_hz, lag_s)
    told = (listen_only, reconnect, rate_hz, lag_s, reconnect, strongest, None if key is None else load_key(key))
    return open_sensor(*_only(port=port, can=can), _site(site), Options(method, node, None, None, *told, bit_rate))


def open_log(
    path: str | Path,
    *,
    site: Site | str | Path,
    node: int | None = None,
    channel: str | None = None,
    track: bool = False,
    on_sensor: bool = False,
    rate_hz: float | None = None,
    lag_s: float | None = None,
) -> Sensor:
    """Open a recording that ``goldfield run --record`` made, or any candump log of a sensor's messages.

    Parameters
    ----------
    path : path
        The log, as candump and ``goldfield run --record`` write it.
    channel : str, optional
        Channel of the sensor, as ``"can0"``, in a log of several buses.
    site, node, track, on_sensor, rate_hz, lag_s
        As for `connect`. With ``on_sensor`` the poses are those that the sensor sent when it was recorded.

    Returns
    -------
    Sensor
        A context manager; `Sensor.poses` yields the poses as fast as they can be computed, up to the end of the log.

    Raises
    ------
    UserError
        If the arguments contradict each other, or the log cannot be read; while reading, if it holds no message, no
        cycle of a sensor, several sensors to choose from, or messages of another protocol.

    Examples
    --------
    In ``docs/examples``:

    >>> import goldfield
    >>> with goldfield.open_log("recording.log", site="room.toml") as sensor:
    ...     poses = list(sensor.poses())
    >>> poses[0].status.value, poses[0].position_m.round(1)
    ('ok', array([0.9, 1.2, 0.8]))
    """
    method = chosen_method(track, on_sensor, rate_hz, lag_s)
    options = Options(method, node, channel=channel, rate_hz=rate_hz, lag_s=lag_s)
    return open_sensor("log", str(path), _site(site), options)


def open_sensor(
    kind: str,
    where: str,
    site: Site,
    options: Options | None = None,
    recorder: Recorder | None = None,
    source: Source | None = None,
) -> Sensor:
    """Open a source as a sensor; `connect` and `open_log` tell the errors.

    Parameters
    ----------
    kind : str
        ``"port"``, a serial port, ``"can"``, a CAN bus, or ``"log"``, a recording.
    where : str
        Path of the port or the log, or ``INTERFACE:CHANNEL``.
    site : Site
    options : Options, optional
    recorder : Recorder, optional
        Gets every message received; the caller closes it.
    source : Source, optional
        What `open_source` has opened already at this place; it is closed with the sensor, or if that fails.
    """
    options = Options() if options is None else options
    options.check(site)
    if kind != "log":  # before anything waits for it
        rehearse(site, options)
    return Sensor(source or open_source(kind, where, options), where, site, options, recorder)


def _site(site: Site | str | Path) -> Site:
    return site if isinstance(site, Site) else load(site)


def _only(**sources: str | Path | None) -> tuple[str, str]:
    given = [(kind, str(where)) for kind, where in sources.items() if where is not None]
    if len(given) != 1:
        what = "no source is" if not given else "more than one source is"
        raise UserError(f"{what} given: give one of {' and '.join(option(kind) for kind in sources)}")
    return given[0]
