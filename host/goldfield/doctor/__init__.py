"""What is wrong with an installation, in plain words: machine, port, boards, beacons, site, each with what to do."""
