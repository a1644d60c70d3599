"""The fault campaign: the arm process on an emulated bus, under every fault that there is, seed by seed.

``make campaign`` runs 200 seeds, ``make campaign ARGS="--seed 17"`` one of them alone. What is checked comes from the
servos' side, the emulator's log of every write, and from what the arm process said.
"""
