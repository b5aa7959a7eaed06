"""What is checked of plate lifts alone."""
