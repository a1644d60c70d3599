"""What MoveIt's messages ask for, and the planners' answers as messages: pure translation, no graph and no clock."""
