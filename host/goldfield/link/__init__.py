"""The link to a sensor board: serial and CAN buses, recorded logs, and the reports assembled from their messages."""
