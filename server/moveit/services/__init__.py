"""Services of MoveIt's move_group."""
