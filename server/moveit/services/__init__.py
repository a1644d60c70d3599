"""MoveIt's services that plan and compute, each in a module of its own; `offer` has the list of them."""
