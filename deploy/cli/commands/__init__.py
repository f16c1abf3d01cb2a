"""Commands of `covey`: names, options and help, by group. They are read before every command, so they import little."""
