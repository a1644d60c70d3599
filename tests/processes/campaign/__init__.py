"""Fault campaign: the arm process on an emulated bus, under every kind of fault, seed by seed.

The checks read the emulator's log of every write to a servo and the messages of the arm process.
"""
