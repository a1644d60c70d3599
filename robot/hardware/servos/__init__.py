"""One driver for servos on a half-duplex bus; a family of servos is a table of registers, a codec and a few methods."""
