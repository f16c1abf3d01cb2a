"""The `covey` command: names, options and help in `commands`, the work in the other modules, which are imported when a command runs."""
