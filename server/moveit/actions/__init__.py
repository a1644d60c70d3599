"""The actions that move the arm, as MoveIt and its controllers offer them: their goals, feedback and results."""
