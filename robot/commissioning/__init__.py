"""Commissioning of an arm: scan, calibration, diagnosis, and experiments on the servos.

Functions that use the bus raise NoReply for a servo that does not answer, and PortError when the port is lost.
"""
