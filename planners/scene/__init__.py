"""What a task is about: the cell, the bodies in it, where they are and what holds them."""
