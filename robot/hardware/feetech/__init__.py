"""Feetech's STS servos as hardware of the controller: packets, registers, settings and calibration."""
