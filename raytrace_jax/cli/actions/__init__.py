"""Actions do the work of commands, once their arguments are read."""
