"""The observation: the stages by which a picture becomes the numbers of a target."""
