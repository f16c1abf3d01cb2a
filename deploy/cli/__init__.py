"""What the subcommands of `covey` do; imported only when a subcommand runs, so that the command starts fast."""
