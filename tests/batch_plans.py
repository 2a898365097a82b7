"""The text of plans for `batch` that take little time."""

from scenes import DATA

HEAD = f"scenes = ['{(DATA / 'vitreous.txt').as_posix()}']\nsettings = {{ size = [16, 12], max_bounces = 1 }}\n"
TWO_VIEWS = f"scenes = ['{(DATA / 'two_views.txt').as_posix()}']\nsettings = {{ size = [32, 24], max_bounces = 3 }}\n"
QUICK_FIT = """[fit]
free = ["cyan.alpha"]
noise = [0.01]
target_samples = 1
edges = "point"
target_sampling = "point"
loss = "l2"
search = false
blur = [1]
"""
