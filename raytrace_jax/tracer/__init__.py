"""From a scene to a picture and its derivative."""
