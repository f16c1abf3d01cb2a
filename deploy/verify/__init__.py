"""Checks of a swarm: the fuzzer, the invariants of every event, and the central filter as an exact reference."""
