"""What is checked of suction-tool plans alone."""
