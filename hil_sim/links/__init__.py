"""The rig's links to the outside: a pseudo-terminal for the serial line, a bridge for the CAN bus."""
