"""The messages of a round: those that an agent sends, those that it has accepted, and their table."""
