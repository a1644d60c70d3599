"""The arm: description, hardware interface, controller, and the arm process that runs them."""
