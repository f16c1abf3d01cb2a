"""Recorded worlds: targets, bodies and scans that come from files of others instead of being simulated."""
