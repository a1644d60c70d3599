"""Classroom: many simulated arms on one machine, a server for each student."""
