"""A trajectory in the format of the TUM RGB-D benchmark, as evo and other tools read it: ``t x y z qx qy qz qw``."""

from __future__ import annotations

from goldfield.feeds.address import Address
from goldfield.feeds.feed import Feed, Setting
from goldfield.feeds.stamped import StampedPose
from goldfield.files.outputs import OutputFile

HEADER = "# unix_s x_m y_m z_m qx qy qz qw\n"


def open_feed(address: Address, setting: Setting) -> Feed:
    """Return the feed that writes a file; `UserError` if it cannot be made, or holds something already."""
    return TumFeed(OutputFile(address.path, "the trajectory", live=True, force=setting.force))


class TumFeed:
    """Writes each usable pose as a line, handed to the system at once.

    Parameters
    ----------
    file : OutputFile
    """

    whole = True
    dropped = 0

    def __init__(self, file: OutputFile) -> None:
        self._file = file
        self._header = HEADER

    def write(self, stamped: StampedPose, /) -> None:
        """Append a pose; one that is not `StampedPose.usable` is left out."""
        if stamped.usable:
            header, self._header = self._header, ""
            self._file.write(f"{header}{tum_line(stamped)}\n".encode())

    def close(self) -> None:
        """Close the file and keep it."""
        self._file.close()


def tum_line(stamped: StampedPose) -> str:
    """Return a pose that is located as a line: time in s since 1970, position in m, unit quaternion."""
    place = " ".join(f"{value:.6f}" for value in stamped.pose.position_m)
    turn = " ".join(f"{value:.9f}" for value in stamped.pose.orientation_xyzw)
    return f"{stamped.unix_s:.6f} {place} {turn}"
