"""Topics and services of MoveIt Servo, and the loop that follows their commands."""
