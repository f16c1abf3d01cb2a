"""Scores of a run: the scorer node, the scores of a tick, the result, and what came of each fault."""
