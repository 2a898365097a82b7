"""What each command takes, as typed dataclasses: tyro makes the parser and the help texts of them.

Nothing here imports JAX, so that `--help` answers at once; and every word that an option can be stands elsewhere, in
the table of what it chooses from.
"""
