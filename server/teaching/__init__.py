"""Motions that people teach the arm: recorded, kept by name, edited, and replayed."""
