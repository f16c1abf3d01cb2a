"""A live swarm: the supervisor, its processes and zygote, the control socket, the run directory."""
