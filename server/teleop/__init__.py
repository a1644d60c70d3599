"""Teleoperation: one arm follows another that is led by hand."""
