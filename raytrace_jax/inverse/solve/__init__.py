"""The solve: from places to start to the answer."""
