"""The arm: what it is, the bus to its servos, and the loop that drives them."""
