"""What every room uses and none owns: numerics, compiling, files, sessions, words."""
