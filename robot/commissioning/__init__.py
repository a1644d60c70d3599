"""Commissioning of an arm by a person: scan, calibrate, doctor, and the experiments behind it."""
