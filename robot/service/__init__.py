"""What a person does with an arm: look for it, calibrate it, examine it."""
