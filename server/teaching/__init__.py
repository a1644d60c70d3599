"""Motions that people teach the arm: recorded, kept by name, edited, and replayed.

Requests that cannot be carried out raise ServiceError, whose sentence goes to the client.
"""
