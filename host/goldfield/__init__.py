"""Host toolkit: from the stream of a sensor board to poses."""
