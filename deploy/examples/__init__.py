"""Programs that take part in a swarm from outside, by its protocol alone."""
