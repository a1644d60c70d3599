"""Emulated servo buses, for work without an arm: Feetech's STS3215 and Dynamixel's XL430 and XL330.

``armbridge emulate`` runs Feetech's on a pseudo terminal, and the arm process either inside itself.
docs/simulation.md lists the modelled effects.
"""
