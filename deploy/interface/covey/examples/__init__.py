"""Examples of what a user brings along: sensor models that a scenario names as `module:Class`."""
