"""Runs on disk: the directory of a run, and the runs that are kept."""
