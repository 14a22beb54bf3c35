"""Indoor position and attitude from coded magnetic fields: the names here are promised, nothing else is.

A sensor on a serial port gives live poses; room.toml says where the beacons are:

>>> import goldfield
>>> site = goldfield.load_site("room.toml")
>>> with goldfield.connect(port="/dev/ttyUSB0", site=site) as sensor:  # doctest: +SKIP
...     for pose in sensor.poses():
...         print(pose.position_m, pose.orientation_xyzw, pose.status)

`connect` and `open_log` return a `Sensor`, live or from a recording. `locate`, `Locator` and `Tracker` turn `Fields`
into a `Pose` without one; `read_fields` reads them from a table. All units are SI; ``B_site = R B_sensor``; quaternions
are (x, y, z, w). Bad input is a `UserError`, a fault of boards or links a `SystemFailure`; the text of both is one
sentence for the user.

The names are loaded when they are first used, so that ``import goldfield`` costs next to nothing.
"""

from importlib import import_module

_HOME = {
    "Fields": ("types", "Fields"),
    "Locator": ("locate", "Locator"),
    "Pose": ("types", "Pose"),
    "Sensor": ("sensor.pipeline", "Sensor"),
    "Site": ("site", "Site"),
    "Status": ("types", "Status"),
    "SystemFailure": ("errors", "SystemFailure"),
    "Tracker": ("track", "Tracker"),
    "UserError": ("errors", "UserError"),
    "connect": ("sensor.opening", "connect"),
    "load_site": ("site", "load"),
    "locate": ("locate", ""),
    "open_log": ("sensor.opening", "open_log"),
    "read_fields": ("sensor.fields_table", "read_fields"),
}
"""Where each public name lives: module and name in it; no name: the module itself, which is callable.

``__init__.pyi`` says the same to type checkers.
"""

__all__ = ["__version__", *_HOME]


def __getattr__(name: str) -> object:
    """Load a public name at its first use (PEP 562)."""
    if name == "__version__":
        from importlib.metadata import version  # heavier than all else here, and rarely asked for

        value: object = version("goldfield")
    elif name in _HOME:
        module, own_name = _HOME[name]
        home = import_module(f"{__name__}.{module}")
        value = getattr(home, own_name) if own_name else home
    else:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    """Return the public names, loaded or not, and no others."""
    return sorted(__all__)
