"""Faults: verbs, links that fail, the fuzzer, what must hold all the time, and the exact oracle."""
