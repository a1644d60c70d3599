"""Execution of goals: their queue, planning, playing and splicing, guarded by the scene and by limits of time."""
