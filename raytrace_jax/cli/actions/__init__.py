"""The work of commands, once their arguments are read."""
