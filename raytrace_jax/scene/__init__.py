"""The scene as a pytree, its vocabulary, its parameters by name, and its file format."""
