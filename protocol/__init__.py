"""What is said: messages, the sensing contract, geometry, and the two drivers that carry nodes.

This room imports no other room. Arrays are numpy, SI units, radians, world frame x east and y north.
"""
