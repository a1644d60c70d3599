"""Servoing: from commands to velocities of the joints, many times a second."""
