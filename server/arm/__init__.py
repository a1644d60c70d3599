"""The arm as a part of the graph: its setup, its services and its topics.

Procedures that cannot begin or go on raise a RobotError, whose sentence goes to the client.
"""
