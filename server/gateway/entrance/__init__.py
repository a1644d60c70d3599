"""Who may connect: the port, the door, and how many there may be."""
