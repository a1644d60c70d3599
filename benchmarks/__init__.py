"""How fast and how even: every figure the documentation quotes is printed by one of these."""
