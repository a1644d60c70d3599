"""Robot descriptions: URDF and SRDF, limits and kinematics, and the built-in arms as package data.

Functions that read a description raise DescriptionError, whose text names the file, the place in it and the remedy.
"""
