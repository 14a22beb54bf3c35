"""Survey: finds beacons and sensor as they are from what a sensor measured, by bundle adjustment."""
