"""Commissioning of an arm: scan, calibration, diagnosis, and experiments on the servos.

Functions that use the bus raise NoReply for a servo that does not answer, PortError when the port is lost,
and CalibrationError for a measurement that makes no calibration.
"""
