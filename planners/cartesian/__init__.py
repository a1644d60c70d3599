"""Motions along a path of the tip, timed by TOPP-RA."""
