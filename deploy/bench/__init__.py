"""Benchmarks: CPU time of this process and ratios against a reference measured in the same run (docs/evidence/performance.md)."""
