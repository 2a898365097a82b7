"""Scenes of Mitsuba 3: as a tree of plugins, from a scene of ours and to one."""
