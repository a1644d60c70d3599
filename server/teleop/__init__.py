"""Teleoperation: one arm follows another that is led by hand.

Requests that cannot be carried out raise ServiceError, whose sentence goes to the client.
"""
