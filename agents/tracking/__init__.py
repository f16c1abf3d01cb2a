"""The targets as one agent believes them: particles, filter, births, estimates, and what is merged from others."""
