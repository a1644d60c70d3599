"""Physics by MuJoCo below the emulated servos and the ideal arm: mass, contact and gravity of links and objects."""
