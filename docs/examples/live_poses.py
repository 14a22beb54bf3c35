"""Print live poses of a sensor board: ``python live_poses.py PORT SITE.toml [SECONDS]``.

Without a board, ``goldfield hil prigge8 --boards host --site room.toml`` simulates one and tells its port.
"""

import sys

import goldfield


def main(port: str, site: str, seconds: float = float("inf")) -> None:
    """Print a line for every pose of so many seconds of the sensor."""
    end_s = None
    with goldfield.connect(port=port, site=site) as sensor:
        for pose in sensor.poses():
            x, y, z = pose.position_m
            print(f"{pose.time_s:8.2f} s  {x:7.3f} {y:7.3f} {z:7.3f} m  {pose.status}", flush=True)
            if end_s is None:
                end_s = pose.time_s + seconds
            if pose.time_s >= end_s:
                break
        print(f"{sensor.bad_frames} corrupt frames; the sensor counted {sensor.counters or 'no errors'}")


if __name__ == "__main__":
    try:
        main(*sys.argv[1:3], *map(float, sys.argv[3:4]))
    except (goldfield.UserError, goldfield.SystemFailure) as error:
        sys.exit(str(error))
