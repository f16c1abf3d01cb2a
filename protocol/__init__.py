"""The protocol room: messages, keys, the sensing contract, geometry, and the two drivers that run nodes.

This room imports no other room. Arrays are numpy, SI units, radians, world frame x east and y north.
"""
