"""What runs programs over pictures: tiles, batches, and plans of how many rays they hold."""
