"""MoveIt Servo's topics and services: steering the arm by sticks, sliders and moving targets."""
