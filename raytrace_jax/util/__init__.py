"""Every room uses these and none owns them: numerics, compiling, files, sessions, words."""
