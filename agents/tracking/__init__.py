"""The belief of one agent about the targets: particles, PHD filter, births, estimates, claims, and the merge with received particles."""
