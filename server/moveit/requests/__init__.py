"""Requests of MoveIt's services and actions, read as problems for the planners, and their answers as messages."""
