"""Commissioning of an arm: scan, setup, calibration, verification and diagnosis."""
