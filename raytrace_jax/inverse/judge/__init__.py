"""How far the answer can be trusted, and the word for it."""
