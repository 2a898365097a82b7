"""How it is solved: scan, search, least squares, corrections, the last level."""
