"""Leader and follower: one arm is moved by hand, another follows."""
