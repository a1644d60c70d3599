"""Commissioning of an arm: scan, setup, calibration, verification, diagnosis, and experiments on the servos."""
