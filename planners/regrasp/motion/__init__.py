"""Motion: from steps of a regrasp sequence to checked and timed segments."""
