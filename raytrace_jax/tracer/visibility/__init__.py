"""What the area that a ray stands for sees, edges included."""
