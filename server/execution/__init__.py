"""Execution of goals: their queue, planning, playing and splicing, guarded by the scene and by limits of time.

Arguments such as ``start_rad`` and ``held_rad`` are the positions of all movable joints by name [rad].
"""
