"""Fault campaign: the arm process on an emulated bus, under every kind of fault, seed by seed.

``make campaign`` runs 200 seeds, ``make campaign ARGS="--seed 17"`` one of them alone. The checks read the
emulator's log of every write to a servo and the messages of the arm process.
"""
