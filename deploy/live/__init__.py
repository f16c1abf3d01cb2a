"""A live swarm: supervisor, child processes, zygote, control socket, certificates and start."""
